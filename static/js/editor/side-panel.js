/** The panel next to the image: its tabs, and on a phone the sheet that it is there. */

import { byId } from "../shared/dom.js";
import { tn } from "../shared/i18n.js";
import { connectTabs } from "../shared/tabs.js";

/**
 * Connect tabs and sheet.
 * @param {import("../shared/map/map-store.js").MapStore} store
 */
export function sidePanel(store) {
  connectTabs(["photos", "check"], (name) => byId(`tab-${name}`).dispatchEvent(new Event("shown")));
  sheet(store);
}

/** On a phone the list lies over the image when it is wanted, and goes when a photo is chosen. */
function sheet(store) {
  const [side, toggle] = [byId("side"), byId("side-toggle")];
  const phone = matchMedia("(max-width: 47.9rem)");
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
    byId("side-toggle-label").textContent = tn("Photos: {n} in the tray", "Photos: {n} in the tray", left);
  };
  store.on("photos placement", count);
  count();
  open(false);
  const more = byId("current-more", HTMLDetailsElement);
  const roomy = matchMedia("(min-width: 88rem), (min-width: 48rem) and (min-height: 60rem)");
  const unfold = () => (more.open = roomy.matches);
  roomy.addEventListener("change", unfold);
  unfold();
}
