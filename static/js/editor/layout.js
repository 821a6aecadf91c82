/** Layout of the page: resizable parts, and on a phone a sheet for the photos. */

import { byId, preventTextDrag, queryAll } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { connectTabs } from "../shared/tabs.js";

const KEPT = "expmap.editor-layout";
const KEY_STEP = 24;
/** Draggable edges: part, axis, sign, minimum size (pixels) and maximum (fraction of the window). */
const EDGES = {
  "side-edge": { name: "side", axis: "x", grows: 1, least: 200, most: 0.6 },
  "strip-edge": { name: "strip", axis: "y", grows: -1, least: 150, most: 0.5 },
  "current-edge": { name: "current", axis: "x", grows: -1, least: 220, most: 0.55 },
};

/**
 * Connect the controls of the layout, which is kept in this browser.
 * @param {import("../shared/map/map-store.js").MapStore} store
 */
export function connectLayout(store) {
  connectTabs(["photos", "check"], (name) => byId(`tab-${name}`).dispatchEvent(new Event("shown")));
  const kept = remembered();
  views(kept);
  for (const id of Object.keys(EDGES)) edge(byId(id), EDGES[id], kept);
  sheet(store);
}

/** @returns {{view?: string, side?: number, strip?: number, current?: number}} */
function remembered() {
  try {
    return JSON.parse(localStorage.getItem(KEPT)) ?? {};
  } catch {
    return {}; // invalid, or of another version
  }
}

function remember(kept) {
  localStorage.setItem(KEPT, JSON.stringify(kept));
}

/** Photos next to the image, as a strip below it, or instead of it. */
function views(kept) {
  const phone = matchMedia("(max-width: 47.99rem)");
  const buttons = queryAll("[data-view]", HTMLButtonElement, byId("photo-view"));
  const show = (view) => {
    byId("editor").dataset.view = view;
    byId("tray-list").classList.toggle("is-strip", view === "strip" && !phone.matches);
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.view === view));
  };
  const chosen = () => (buttons.some(({ dataset }) => dataset.view === kept.view) ? kept.view : "side");
  for (const button of buttons) {
    button.addEventListener("click", () => {
      kept.view = button.dataset.view;
      remember(kept);
      show(kept.view);
    });
  }
  phone.addEventListener("change", () => show(chosen()));
  show(chosen());
}

/** An edge between two parts, moved by dragging it or by the arrow keys. */
function edge(element, { name, axis, grows, least, most }, kept) {
  const editor = byId("editor");
  const limit = () => Math.round((axis === "x" ? innerWidth : innerHeight) * most);
  const part = byId(element.getAttribute("aria-controls"));
  const now = () => part.getBoundingClientRect()[axis === "x" ? "width" : "height"];
  const set = (size) => {
    kept[name] = Math.round(Math.min(Math.max(size, least), limit()));
    editor.style.setProperty(`--${name}`, `${kept[name]}px`);
    element.setAttribute("aria-valuenow", String(kept[name]));
    element.setAttribute("aria-valuemin", String(least));
    element.setAttribute("aria-valuemax", String(limit()));
  };
  if (Number.isFinite(kept[name])) set(kept[name]);
  const at = (event) => (axis === "x" ? event.clientX : event.clientY);
  preventTextDrag(element);
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    const [from, size] = [at(event), now()];
    const move = (moved) => set(size + grows * (at(moved) - from));
    element.addEventListener("pointermove", move);
    element.addEventListener("lostpointercapture", () => {
      element.removeEventListener("pointermove", move);
      remember(kept);
    }, { once: true });
  });
  const steps = axis === "x" ? { ArrowLeft: -1, ArrowRight: 1 } : { ArrowUp: -1, ArrowDown: 1 };
  element.addEventListener("keydown", (event) => {
    if (!(event.key in steps)) return;
    event.preventDefault();
    set(now() + grows * steps[event.key] * KEY_STEP);
    remember(kept);
  });
}

/** On a phone the photos are a sheet over the image, which closes when one is chosen. */
function sheet(store) {
  const [side, toggle] = [byId("side"), byId("side-toggle")];
  const phone = matchMedia("(max-width: 47.99rem)");
  const open = (wanted) => {
    side.classList.toggle("is-open", wanted);
    toggle.setAttribute("aria-expanded", String(wanted));
    byId("side-body").inert = phone.matches && !wanted;
  };
  toggle.addEventListener("click", () => open(!side.classList.contains("is-open")));
  phone.addEventListener("change", () => open(false));
  store.on("current", () => phone.matches && open(false));
  const count = () => {
    const left = store.unplaced().length;
    byId("side-toggle-label").textContent = left ? tn("Photos: {n} in the tray", "Photos: {n} in the tray", left) : t("Photos");
  };
  store.on("photos placement", count);
  count();
  open(false);
  const more = byId("current-more", HTMLDetailsElement);
  const roomy = matchMedia("(min-width: 64rem), (min-width: 48rem) and (min-height: 60rem)");
  const unfold = () => (more.open = roomy.matches);
  roomy.addEventListener("change", unfold);
  unfold();
}
