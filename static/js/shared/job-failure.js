/** The failure of the last job of a page: shown until it is dismissed, or the job repeated. */

import { get } from "./api.js";
import { h, icon } from "./dom.js";
import { t } from "./i18n.js";
import { sentence } from "./toast.js";

const KEY = "expmap.dismissed-jobs";
const MOST = 200;

const dismissed = () => JSON.parse(localStorage.getItem(KEY) ?? "[]");

/** Whether a job was dismissed in this browser. @param {number} id */
export function isDismissed(id) {
  return dismissed().includes(id);
}

/** No longer show a job that has ended. @param {number} id */
export function dismiss(id) {
  localStorage.setItem(KEY, JSON.stringify([...dismissed(), id].slice(-MOST)));
}

/**
 * Show why the last job of some kinds failed, unless it was dismissed; an older message is removed.
 * @param {HTMLElement} before the message stands after this element
 * @param {string} slug of the map
 * @param {string[]} kinds
 */
export async function showLastFailure(before, slug, kinds) {
  const { jobs } = await get(`/jobs?map=${encodeURIComponent(slug)}`);
  const last = jobs.find(({ kind }) => kinds.includes(kind)); // the newest is the first
  document.querySelector("[data-job-failure]")?.remove();
  if (last?.state === "failed" && !isDismissed(last.id)) before.after(failureNote(last));
}

/** The message of a failed job, with a button that dismisses it. @param {Object} job */
export function failureNote({ id, error: { message, hint } }) {
  const remove = () => {
    dismiss(id);
    shown.remove();
  };
  const shown = h("div", { class: "note note--danger", "data-testid": "error-message", "data-job-failure": id },
    icon("warning"),
    h("div", {}, h("div", {}, sentence(message)), hint && h("div", { class: "small" }, sentence(hint))),
    h("button", { class: "icon-button note__link", type: "button", "aria-label": t("Dismiss"), onclick: remove }, icon("close")));
  return shown;
}
