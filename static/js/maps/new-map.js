/**
 * Creates a map from photos: they are uploaded at once, and its image is chosen afterwards.
 *
 * The map exists from the first photo on, so that closing the page loses no uploaded photos.
 */

import { patch, post } from "../shared/api.js";
import { busy } from "../shared/dialogs.js";
import { byId, h } from "../shared/dom.js";
import { listenToDrops, listenToPastes, usable } from "../shared/drop-files.js";
import { locale, t, tn } from "../shared/i18n.js";
import { keepNotes } from "../shared/kept-notes.js";
import { rafThrottle } from "../shared/timing.js";
import { sentence } from "../shared/toast.js";
import { canGoAgain, uploadEndpoints, Uploads } from "../shared/uploads.js";

const NOTES = 5;
const name = byId("map-name", HTMLInputElement);
const proposed = t("Map of {day}", { day: new Date().toLocaleDateString(locale, { dateStyle: "long" }) });
/** @type {?Promise<{slug: string, name: string}>} */
let making = null;
/** @type {?Uploads} */
let uploads = null;

name.value = proposed;
name.addEventListener("change", () => making && rename().catch(show));
byId("new-map", HTMLFormElement).addEventListener("submit", (event) => {
  event.preventDefault();
  if (!uploads) busy(event.submitter, async () => location.assign(`/maps/${(await make()).slug}/edit`)).catch(show);
});
for (const [button, input] of [["photos-button", "photo-input"], ["folder-button", "folder-input"]]) {
  const chosen = byId(input, HTMLInputElement);
  byId(button).addEventListener("click", () => chosen.click());
  chosen.addEventListener("change", () => {
    const files = usable(chosen.files);
    chosen.value = "";
    take(files);
  });
}
listenToDrops(byId("drop"), take);
listenToPastes(take);
byId("again").addEventListener("click", () => uploads.retry());
byId("stop").addEventListener("click", () => (uploads.busy ? uploads.cancel() : goOn()));
for (const control of document.querySelectorAll("#new-map [disabled]")) control.removeAttribute("disabled"); // disabled until listeners are attached
name.focus();
name.select();

/** Make the map, once. */
function make() {
  making ??= post("/maps", { name: name.value }).catch((error) => {
    making = null;
    throw error;
  });
  return making;
}

async function rename() {
  const { slug } = await making;
  await patch(`/maps/${slug}`, { name: name.value });
  show(null);
}

/** @param {File[]} files */
async function take(files) {
  if (!files.length) return;
  const [folder] = files[0].webkitRelativePath.split("/");
  if (folder && name.value === proposed && !making) name.value = folder.slice(0, name.maxLength);
  try {
    const { slug } = await make();
    uploads ??= sendingTo(slug);
    show(null);
    uploads.add(files);
  } catch (error) {
    show(error);
  }
}

function sendingTo(slug) {
  const made = new Uploads(uploadEndpoints(slug), { slug, photos: new Map(), isPlaced: () => false });
  byId("choose-photos").hidden = true;
  byId("without").hidden = true;
  byId("sending").hidden = false;
  made.addEventListener("progress", rafThrottle(progress));
  made.addEventListener("finished", () => {
    progress();
    if (!made.entries.some(canGoAgain) && made.entries.some(arrived)) goOn();
  });
  return made;
}

function progress() {
  const { entries } = uploads;
  const ended = entries.filter(({ state }) => state !== "waiting" && state !== "sending").length;
  const failed = entries.filter(({ state }) => state === "failed");
  byId("sending-title").textContent = t("Adding photos: {done} of {all}", { done: ended, all: entries.length });
  Object.assign(byId("sending-bar", HTMLProgressElement), { max: Math.max(entries.length, 1), value: ended });
  byId("failed").replaceChildren(...failed.slice(0, NOTES).map((entry) => h("li", {}, reason(entry))), ...more(failed).map((text) => h("li", {}, text)));
  byId("again").hidden = uploads.busy || !entries.some(canGoAgain);
}

/** Continue with the image of the map after the upload. */
async function goOn() {
  const { slug } = await making;
  const failed = uploads.entries.filter(({ state }) => state === "failed");
  const texts = [...failed.slice(0, NOTES).map(reason), ...more(failed)];
  keepNotes(texts.map((text) => ({ kind: "warning", text })));
  location.assign(`/maps/${slug}/image`);
}

const arrived = ({ state }) => state === "done";

/** Why a file was not added. */
function reason({ file, error }) {
  return t("Not added: {name}. {reason}", { name: file.name, reason: [error.message, error.hint].filter(Boolean).map(sentence).join(". ") });
}

/** Number of files that are not listed. */
function more(failed) {
  const rest = failed.length - NOTES;
  return rest > 0 ? [tn("and {n} more", "and {n} more", rest)] : [];
}

function show(error) {
  const line = byId("new-error");
  line.hidden = !error;
  line.textContent = error ? [error.message, error.hint].filter(Boolean).map(sentence).join(". ") : "";
}
