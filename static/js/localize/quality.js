/** The page Quality: starts the evaluation and follows its job. */

import { get, post } from "../shared/api.js";
import { busy } from "../shared/dialogs.js";
import { duration, t } from "../shared/i18n.js";
import { showLastFailure } from "../shared/job-failure.js";
import { queuedText } from "../shared/job-list.js";
import { toastError } from "../shared/toast.js";

const ASK_MS = 1000;

const { map, job } = JSON.parse(document.getElementById("page").textContent);
const button = /** @type {?HTMLButtonElement} */ (document.getElementById("evaluate"));
const bar = document.getElementById("bar");

button?.addEventListener("click", () => busy(button, start).catch(toastError));
if (job === null) lastFailure().catch(toastError);
else follow(job);

function lastFailure() {
  return showLastFailure(document.getElementById("progress"), map, ["evaluate"]);
}

async function start() {
  document.querySelector("[data-job-failure]")?.remove();
  const { id } = await post(`/maps/${encodeURIComponent(map)}/evaluation`, {});
  follow(id);
}

/** Show the progress of a job until it ends, and reload the page when it is done. */
async function follow(id) {
  document.getElementById("progress").hidden = false;
  document.getElementById("words").textContent = t("Evaluating the map");
  if (button) button.hidden = true;
  for (;;) {
    try {
      const found = document.hidden ? null : await get(`/jobs/${id}`);
      if (found?.state === "done") return location.reload();
      if (found && ended(found)) return;
    } catch (error) {
      if (error.code !== "offline") return stop(error);
    }
    await new Promise((resolve) => setTimeout(resolve, ASK_MS));
  }
}

/** Show the progress. @returns {boolean} whether it ended without a result */
function ended(found) {
  const { state, done, total, note, seconds_left: left, error } = found;
  if (state === "failed") {
    stop(error);
    lastFailure().catch(toastError);
  }
  if (state === "cancelled") stop({ message: t("cancelled"), hint: null, code: state });
  if (total > 0 && state === "running") Object.assign(bar, { max: total, value: Math.min(done, total) });
  else bar.removeAttribute("value");
  const parts = [total > 0 && t("{done} of {total}", { done, total }), note, left !== null && t("about {time} left", { time: duration(left) })];
  const words = state === "queued" ? queuedText(found) : parts.filter(Boolean).join(" · ") || t("Evaluating the map");
  document.getElementById("words").textContent = words;
  return state === "failed" || state === "cancelled";
}

function stop(error) {
  document.getElementById("progress").hidden = true;
  if (button) button.hidden = false;
  toastError({ code: "job", ...error, message: error.message, hint: error.hint });
}
