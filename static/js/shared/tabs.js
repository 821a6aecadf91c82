/** Tabs: one is open, the arrow keys switch between them. */

import { byId } from "./dom.js";

const STEPS = { ArrowLeft: -1, ArrowRight: 1 };

/**
 * Connect the tabs `#tab-NAME`, each with the panel that its `aria-controls` names.
 * @param {string[]} names in their order; the template opens the first
 * @param {function(string): void} [shown] called with the name of the tab that was opened
 * @returns {function(string): void} opens a tab by name
 */
export function connectTabs(names, shown = () => {}) {
  const tabs = names.map((name) => byId(`tab-${name}`));
  const show = (name) => {
    tabs.forEach((tab, n) => {
      const open = names[n] === name;
      tab.setAttribute("aria-selected", String(open));
      tab.tabIndex = open ? 0 : -1;
      byId(tab.getAttribute("aria-controls")).hidden = !open;
    });
    shown(name);
  };
  tabs.forEach((tab, n) => {
    tab.addEventListener("click", () => show(names[n]));
    tab.addEventListener("keydown", (event) => {
      if (!STEPS[event.key]) return;
      const seen = tabs.filter((one) => !one.hidden);
      const other = seen[(seen.indexOf(tab) + STEPS[event.key] + seen.length) % seen.length];
      show(names[tabs.indexOf(other)]);
      other.focus();
      event.preventDefault();
    });
  });
  return show;
}
