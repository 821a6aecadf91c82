/** Polls a job of a mission until it has ended. */

import { h } from "../shared/dom.js";
import { duration, t } from "../shared/i18n.js";
import { queuedText } from "../shared/job-list.js";

const ASK_MS = 700;

/** A progress bar with text for a job. @returns {HTMLElement & {showJob: function(Object): void}} */
export function jobBar(label) {
  const bar = h("progress", { class: "progress", "aria-label": label });
  const words = h("div", { class: "small soft number" }, label);
  const box = h("div", { class: "stack stack--tight", "data-testid": "job-progress" }, words, bar);
  const showJob = (job) => {
    const { state, done, total, note, seconds_left: left } = job;
    if (state === "running" && total > 0) Object.assign(bar, { max: total, value: Math.min(done, total) });
    else bar.removeAttribute("value");
    const parts = state === "queued" ? [queuedText(job)] : [label, note];
    if (left) parts.push(t("about {time} left", { time: duration(left) }));
    words.textContent = parts.filter(Boolean).join(" · ");
  };
  return Object.assign(box, { showJob });
}

/**
 * Wait for the end of a job.
 * @param {function(number): Promise<Object>} ask
 * @param {number} id
 * @param {function(Object): void} show called with each state
 * @returns {Promise<Object>} the finished job
 * @throws {Error} why it failed, with a hint
 */
export async function ended(ask, id, show) {
  for (;;) {
    const job = await ask(id);
    show(job);
    if (job.state === "done") return job;
    if (job.state === "failed") throw Object.assign(new Error(job.error.message), { code: "job", hint: job.error.hint });
    if (job.state === "cancelled") throw Object.assign(new Error(t("It was cancelled.")), { code: "job", hint: null });
    await new Promise((resolve) => setTimeout(resolve, ASK_MS));
  }
}
