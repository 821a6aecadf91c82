/** Sends an export of a field form, and goes to the jobs of its map. */

import { upload } from "../shared/api.js";
import { toastError } from "../shared/toast.js";

const form = document.getElementById("form-export");
if (form instanceof HTMLFormElement) form.addEventListener("submit", send);

/** @param {SubmitEvent} event */
async function send(event) {
  event.preventDefault();
  const given = new FormData(/** @type {HTMLFormElement} */ (form));
  const slug = String(given.get("map"));
  const body = new FormData();
  body.append("file", /** @type {File} */ (given.get("file")));
  const media = given.get("media");
  if (media instanceof File && media.name) body.append("media", media);
  body.append("all_answers", String(given.has("all_answers")));
  const button = /** @type {HTMLButtonElement} */ (form.querySelector("button"));
  const bar = /** @type {HTMLProgressElement} */ (form.querySelector("progress"));
  button.disabled = true;
  bar.hidden = false;
  try {
    const onProgress = (sent, all) => Object.assign(bar, { value: sent, max: all });
    await upload(`/maps/${slug}/field-forms`, { body, onProgress });
    location.assign(`/maps/${slug}/jobs`);
  } catch (error) {
    toastError(error);
    button.disabled = false;
    bar.hidden = true;
  }
}
