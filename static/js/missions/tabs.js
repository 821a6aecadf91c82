/** The tabs of the panel. */

import { byId } from "../editor/page.js";

const STEPS = { ArrowLeft: -1, ArrowRight: 1 };

/** @param {string[]} names of the tabs, in their order; the first is open */
export function connectTabs(names) {
  const tabs = names.map((name) => byId(`tab-${name}`));
  const show = (tab) => {
    for (const other of tabs) {
      other.setAttribute("aria-selected", String(other === tab));
      other.tabIndex = other === tab ? 0 : -1;
      byId(other.getAttribute("aria-controls")).hidden = other !== tab;
    }
  };
  byId("panel").inert = false; // until now a click would have been lost
  tabs.forEach((tab, n) => {
    tab.addEventListener("click", () => show(tab));
    tab.addEventListener("keydown", (event) => {
      if (!STEPS[event.key]) return;
      const other = tabs[(n + STEPS[event.key] + tabs.length) % tabs.length];
      show(other);
      other.focus();
      event.preventDefault();
    });
  });
}
