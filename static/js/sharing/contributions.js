/** Photos from visitors: each is accepted at its suggested place, or refused, with one click; both can be undone. */

import { del, get, post, put } from "../shared/api.js";
import { busy } from "../shared/dialogs.js";
import { byId, h, icon } from "../shared/dom.js";
import { percentText } from "../shared/format.js";
import { moment, t, tn } from "../shared/i18n.js";
import { toast, toastError } from "../shared/toast.js";

const page = JSON.parse(byId("page").textContent);
const base = `/maps/${encodeURIComponent(page.slug)}`;

const AGAIN_MS = 3000;
const HIDDEN_MS = 30000;

let again = 0;
let waiting = 0;

if (page.can_edit) show().catch(toastError);

async function show() {
  const found = await get(`${base}/contributions`);
  count((waiting = found.waiting));
  const cards = found.photos.map(card);
  byId("photos").replaceChildren(...cards);
  clearTimeout(again);
  if (searched(found)) again = setTimeout(() => look(searched(found)), AGAIN_MS);
  if (!page.searches) return;
  for (const [n, photo] of found.photos.entries()) {
    if (cards[n].isConnected) await suggestBlur(photo, cards[n]);
  }
}

/** Show the photos again when a place that was being looked for has been found, or not. */
async function look(before) {
  try {
    if (!document.hidden && searched(await get(`${base}/contributions`)) < before) return await show();
  } catch (error) {
    if (error.code !== "offline") return toastError(error);
  }
  again = setTimeout(() => look(before), document.hidden ? HIDDEN_MS : AGAIN_MS);
}

/** @param {Api["WaitingList"]} found */
function searched({ photos }) {
  return photos.filter(({ searching }) => searching).length;
}

function count(n) {
  byId("waiting").textContent = n ? tn("{n} photo waits.", "{n} photos wait.", n) : t("No photos wait.");
}

/** @param {Api["WaitingOut"]} photo */
function card(photo) {
  const isPlaced = photo.x_px !== null;
  const accept = h("button", { class: "button button--primary", type: "button", disabled: !isPlaced, "data-testid": "accept" }, icon("check"), t("Accept"));
  const refuse = h("button", { class: "button", type: "button", "data-testid": "refuse" }, icon("trash"), t("Refuse"));
  accept.addEventListener("click", () => decide(accept, t("The photo was accepted"), () => post(`${base}/contributions/${photo.id}/accept`)));
  refuse.addEventListener("click", () => decide(refuse, t("The photo was refused"), () => del(`${base}/experiences/${photo.id}`)));
  return h("li", { class: "card co-card", "data-testid": "contribution", dataset: { id: photo.id } },
    h("div", { class: "co-pictures" },
      h("img", { class: "co-photo", src: photo.preview, alt: photo.name, width: photo.width, height: photo.height, loading: "lazy" }),
      page.satellite && isPlaced && spot(photo)),
    h("div", { class: "co-text" },
      h("div", {}, photo.name),
      h("div", { class: "small soft" }, moment(photo.sent_at), " · ", placeText(photo)),
      h("div", { class: "small", "data-part": "blur" })),
    h("div", { class: "row co-buttons" }, accept, refuse,
      h("a", { class: "button button--quiet", href: `${base}/edit?photo=${photo.id}` }, icon("pencil"), t("In the editor"))));
}

/** @param {Api["WaitingOut"]} photo */
function placeText({ x_px: x, probability, searching }) {
  if (searching) return t("its place is looked for when the map is ready");
  if (x === null) return t("place not found: place it in the editor, or refuse it");
  return t("found, with {probability}", { probability: percentText(probability) });
}

/** The image of the map with the suggested place. @param {Api["WaitingOut"]} photo */
function spot({ x_px: x, y_px: y }) {
  const { width, height, url } = page.satellite;
  const dot = h("span", { class: "co-dot" });
  dot.style.left = `${(100 * x) / width}%`;
  dot.style.top = `${(100 * y) / height}%`;
  return h("div", { class: "co-map" }, h("img", { src: url, alt: t("Suggested place"), loading: "lazy" }), dot);
}

async function decide(button, said, request) {
  await busy(button, async () => {
    try {
      await request();
      toast(said, { action: { label: t("Undo"), run: () => post(`${base}/undo`).then(show).catch(toastError) } });
      await leave(button.closest("li"));
    } catch (error) {
      toastError(error);
    }
  });
}

/** Take a card away; the others stay where they are, with what was found in their photos. */
async function leave(element) {
  const next = element.nextElementSibling ?? element.previousElementSibling;
  element.remove();
  count((waiting -= 1));
  if (!next) return show();
  next.querySelector("button:enabled")?.focus({ preventScroll: true });
}

/** Offer to blur the faces and plates that are found in a photo. */
async function suggestBlur(photo, element) {
  const { boxes } = await get(`${base}/photos/${photo.id}/blur/suggestions`);
  if (!boxes.length) return;
  const wanted = boxes.map(({ x, y, width, height }) => ({ x, y, width, height }));
  const blur = h("button", { class: "button button--quiet", type: "button", "data-testid": "blur" }, t("Blur them"));
  blur.addEventListener("click", () => busy(blur, () => put(`${base}/photos/${photo.id}/blur`, { boxes: wanted }).then(show)).catch(toastError));
  const place = element.querySelector("[data-part=blur]");
  place.replaceChildren(tn("{n} face or plate was found.", "{n} faces or plates were found.", boxes.length), " ", blur);
}
