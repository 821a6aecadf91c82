/** An image from a file, or a blank plan. */

import { post, upload } from "../shared/api.js";
import { busy } from "../shared/dialogs.js";
import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";
import { outsideChoices } from "./outside-photos.js";
import { base, movedPhotoNotes, page, reloadWith } from "./page.js";

/** Connect the form with a file. */
export function uploadForm() {
  const form = byId("way-upload", HTMLFormElement);
  const bar = form.querySelector("progress");
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    busy(event.submitter, () => trying((choice) => send(form, bar, choice))).catch(toastError);
  });
}

/** Connect the form of a blank plan. */
export function blankForm() {
  const form = byId("way-blank", HTMLFormElement);
  const byPhotos = () => new FormData(form).get("blank") === "photos";
  form.addEventListener("change", () => (byId("blank-size").hidden = byPhotos()));
  form.noValidate = Boolean(page.photos);
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const size = { width: byId("blank-width", HTMLInputElement).valueAsNumber, height: byId("blank-height", HTMLInputElement).valueAsNumber };
    const wish = byPhotos() ? {} : size;
    busy(event.submitter, () => trying((choice) => post(`${base}/satellite/blank`, { ...wish, ...choice }))).catch(toastError);
  });
}

/** Run a request, and again after a decision about photos outside the image. */
async function trying(run) {
  let answer;
  try {
    answer = await run({});
  } catch (error) {
    const choice = await outsideChoices(error);
    if (!choice) {
      if (/would lie outside/.test(error.message)) return;
      throw error;
    }
    answer = await run(choice);
  }
  const notes = [{ kind: "success", text: t("The image is in place.") }, ...movedPhotoNotes(answer.from_tray, answer.to_tray)];
  reloadWith([...notes, ...answer.warnings.map((text) => ({ kind: "warning", text }))]);
}

async function send(form, bar, choice) {
  const body = new FormData();
  body.append("file", byId("image-file", HTMLInputElement).files[0]);
  const [worldfile] = byId("image-worldfile", HTMLInputElement).files;
  if (worldfile) body.append("worldfile", worldfile);
  if (worldfile && byId("image-crs", HTMLInputElement).value.trim()) body.append("crs", byId("image-crs", HTMLInputElement).value.trim());
  for (const [name, value] of Object.entries(choice)) body.append(name, String(value));
  bar.hidden = false;
  bar.removeAttribute("value");
  // after the upload, the server still processes the image
  const onProgress = (sent, all) => (sent < all ? (bar.value = sent / all) : bar.removeAttribute("value"));
  try {
    return await upload(`${base}/satellite`, { method: "PUT", body, onProgress });
  } finally {
    bar.hidden = true;
  }
}
