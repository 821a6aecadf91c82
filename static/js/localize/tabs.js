/** The two tabs of the panel. */

import { byId } from "../editor/page.js";

/**
 * @param {function(string): void} shown told the name of the tab
 * @returns {function(string): void} opens a tab by name
 */
export function connectTabs(shown) {
  const tabs = ["answer", "history"].map((name) => byId(`tab-${name}`));
  const show = (tab) => {
    for (const other of tabs) {
      const chosen = other === tab;
      other.setAttribute("aria-selected", String(chosen));
      other.tabIndex = chosen ? 0 : -1;
      byId(other.getAttribute("aria-controls")).hidden = !chosen;
    }
    shown(tab.id.replace("tab-", ""));
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
  return (name) => show(byId(`tab-${name}`));
}
