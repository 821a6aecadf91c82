/**
 * Creates a map from photos: they are uploaded at once, and its image is chosen afterwards.
 *
 * The map exists from the first photo on, so that closing the page loses no uploaded photos; a reload offers
 * to continue with it.
 */

import { get, patch, post } from "../shared/api.js";
import { busy } from "../shared/dialogs.js";
import { byId, h, icon } from "../shared/dom.js";
import { listenToDrops, listenToPastes, usable } from "../shared/drop-files.js";
import { locale, t, tn } from "../shared/i18n.js";
import { keepNotes } from "../shared/kept-notes.js";
import { rafThrottle } from "../shared/timing.js";
import { sentence } from "../shared/toast.js";
import { canGoAgain, uploadEndpoints, Uploads } from "../shared/uploads.js";

const NOTES = 5;
const BEGUN = "expmap.new-map";
/** In the storage of the tab: the map whose upload has not ended. */
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
offerBegun().catch(show);

/** After a reload amid an upload: offer to continue with the map that has the first photos. */
async function offerBegun() {
  const begun = JSON.parse(sessionStorage.getItem(BEGUN) ?? "null");
  if (!begun) return;
  sessionStorage.removeItem(BEGUN);
  const state = await get(`/maps/${begun.slug}`).catch((error) => (error.code === "not_found" ? null : Promise.reject(error)));
  if (!state?.photos.length || making) return;
  const close = () => offer.remove();
  const button = h("button", { class: "button button--primary", type: "button" }, t("Add the rest to it"));
  const link = h("a", { class: "button", href: `/maps/${begun.slug}/image` }, t("Continue without the rest"));
  const other = h("button", { class: "icon-button note__link", type: "button", "aria-label": t("Dismiss"), onclick: close }, icon("close"));
  const text = tn("The upload to {name} was interrupted: it has {n} photo.", "The upload to {name} was interrupted: it has {n} photos.", state.photos.length, { name: state.name });
  const offer = h("div", { class: "note note--info", role: "status", "data-testid": "begun-map" }, icon("info"),
    h("div", { class: "stack stack--tight" },
      h("div", {}, text, " ", t("Choose the same photos again: only the rest is sent.")),
      h("div", { class: "row" }, button, link)), other);
  button.addEventListener("click", () => {
    making = Promise.resolve({ slug: begun.slug, name: state.name });
    name.value = state.name;
    close();
    byId("photos-button").focus();
  });
  byId("new-map").before(offer);
}

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
    sessionStorage.setItem(BEGUN, JSON.stringify({ slug }));
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
  sessionStorage.removeItem(BEGUN);
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
