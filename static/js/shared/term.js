/** Technical terms explained in place: a "?" that opens the meaning. */

import { h, queryAll } from "./dom.js";
import { t } from "./i18n.js";

const MARGIN = 8;
const TERMS = {
  tray: () => [t("Tray"), t("Photos of this map that have no place on the image yet.")],
  placement: () => [t("Placement"), t("One set of photo positions. The same photos can have several, such as exact spots and whole areas; each has its own .cfg.")],
  inliers: () => [t("Matching points"), t("Points seen in both photos that agree on one position of the camera (inliers). The more there are, the more certain is the place.")],
  fuse: () => [t("Correct the track"), t("Combines odometry, GPS and visual fixes into one corrected track; the other tracks stay as they are.")],
  utm: () => ["UTM", t("Universal Transverse Mercator: metres east and north within a numbered zone, as on hiking maps.")],
  mgrs: () => ["MGRS", t("Military Grid Reference System: a square of the UTM grid, and metres within it, as rescue services use it.")],
};
let made = 0;

/** A button that opens the meaning of a term. @param {string} name one of `TERMS` @returns {HTMLElement} */
export function term(name) {
  const [word, meaning] = TERMS[name]();
  made += 1;
  const id = `term-${made}`;
  const button = h("button", { class: "term", type: "button", popovertarget: id, "aria-label": t("What does “{word}” mean?", { word }), "data-testid": `term-${name}` }, "?");
  const box = h("div", { class: "term__box", id, popover: "auto", role: "note" },
    h("strong", {}, word), h("p", {}, meaning), h("a", { class: "small", href: "/help/notation#glossary" }, t("All terms")));
  box.addEventListener("toggle", () => putBelow(box, button));
  return h("span", { class: "term__frame" }, button, box);
}

/** Add the buttons to elements with `data-term`. */
export function connectTerms() {
  for (const place of queryAll("[data-term]")) place.replaceChildren(term(place.dataset.term));
}

/** Position a box below the button, or above it if there is no space; always on the screen. */
function putBelow(box, button) {
  const [at, size] = [button.getBoundingClientRect(), box.getBoundingClientRect()];
  const left = Math.min(Math.max(at.left, MARGIN), innerWidth - size.width - MARGIN);
  const below = at.bottom + MARGIN;
  const top = below + size.height > innerHeight - MARGIN ? Math.max(at.top - size.height - MARGIN, MARGIN) : below;
  Object.assign(box.style, { left: `${left}px`, top: `${top}px` });
}
