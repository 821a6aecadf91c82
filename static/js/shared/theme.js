/** The switch between light, dark and system theme, kept in a cookie so that the server renders pages with it. */

import { queryAll } from "./dom.js";

const YEAR_S = 31_536_000;

/**
 * Connect the buttons of the switch.
 * @param {HTMLElement} root with buttons that have `data-theme-choice`
 */
export function connectTheme(root) {
  const buttons = queryAll("[data-theme-choice]", HTMLButtonElement, root);
  const show = () => {
    const now = document.documentElement.dataset.theme || "system";
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.themeChoice === now));
  };
  for (const button of buttons) {
    button.addEventListener("click", () => {
      choose(button.dataset.themeChoice);
      show();
    });
  }
  show();
}

function choose(theme) {
  if (theme === "system") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  const age = theme === "system" ? 0 : YEAR_S;
  document.cookie = `expmap-theme=${theme}; path=/; max-age=${age}; samesite=lax`;
}
