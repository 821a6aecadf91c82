/** The panel beside the image: its tabs, and on a phone the sheet that it is there. */

import { tn } from "../i18n.js";
import { byId } from "./page.js";

/**
 * Connect tabs and sheet.
 * @param {import("./store.js").Store} store
 * @returns {{show: function(string): void}} `show` opens a tab by name
 */
export function sidePanel(store) {
  const tabs = [byId("tab-photos"), byId("tab-check")];
  const show = (tab) => {
    for (const other of tabs) {
      const chosen = other === tab;
      other.setAttribute("aria-selected", String(chosen));
      other.tabIndex = chosen ? 0 : -1;
      byId(other.getAttribute("aria-controls")).hidden = !chosen;
    }
    tab.dispatchEvent(new Event("shown"));
  };
  tabs.forEach((tab, n) => {
    tab.addEventListener("click", () => show(tab));
    tab.addEventListener("keydown", (event) => {
      if (event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
      const other = tabs[(n + 1) % tabs.length];
      show(other);
      other.focus();
      event.preventDefault();
    });
  });
  sheet(store);
  return { show: (name) => show(byId(`tab-${name}`)) };
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
  const more = byId("current-more");
  const roomy = matchMedia("(min-width: 88rem), (min-width: 48rem) and (min-height: 60rem)");
  const unfold = () => (more.open = roomy.matches);
  roomy.addEventListener("change", unfold);
  unfold();
}
