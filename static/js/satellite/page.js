/** What this page knows of its map, and words that outlive a reload. */

import { h, icon } from "../dom.js";
import { sentence } from "../toast.js";

/** Data of the page: `slug`, `revision`, `satellite`, `earth`, `services`, `photos`, `canEdit`. */
export const page = JSON.parse(document.getElementById("page").textContent);

/** Address of this map in the API. */
export const base = `/maps/${page.slug}`;

const KEY = "expmap-image-notes";

/** Find an element by its id. */
export const byId = (id) => document.getElementById(id);

/**
 * Show the page anew, with messages at its top.
 * @param {Array<{kind: "success"|"warning", text: string}>} notes
 */
export function reloadWith(notes) {
  sessionStorage.setItem(KEY, JSON.stringify(notes));
  location.reload();
}

/** Show the messages that were kept for this page. */
export function showKeptNotes() {
  const kept = JSON.parse(sessionStorage.getItem(KEY) || "[]");
  sessionStorage.removeItem(KEY);
  byId("notes").append(...kept.map(({ kind, text }) => note(kind, text)));
}

/**
 * Make a message that stays in the page.
 * @param {"success"|"warning"|"danger"|"info"} kind
 * @param {string} text
 * @param {?string} [hint]
 * @returns {HTMLElement}
 */
export function note(kind, text, hint = null) {
  const symbol = { success: "check", info: "info" }[kind] || "warning";
  const words = [h("div", {}, sentence(text)), hint && h("div", { class: "small" }, sentence(hint))];
  const testid = kind === "danger" ? "error-message" : null;
  return h("div", { class: `note note--${kind}`, "data-testid": testid }, icon(symbol), h("div", {}, ...words));
}

/**
 * Connect a row of buttons of which one is chosen, each with a panel.
 * @param {string} attribute of the buttons, `data-way`
 * @param {function(string): void} chosen called with the value of the button that is pressed
 * @returns {function(string): void} chooses one
 */
export function panels(attribute, chosen) {
  const buttons = [...document.querySelectorAll(`[data-${attribute}]`)];
  const choose = (value) => {
    for (const button of buttons) {
      const is = button.dataset[attribute] === value;
      button.setAttribute("aria-pressed", String(is));
      byId(button.getAttribute("aria-controls")).hidden = !is;
    }
    chosen(value);
  };
  for (const button of buttons) button.addEventListener("click", () => choose(button.dataset[attribute]));
  return choose;
}

/** A latitude and longitude that somebody wrote, as `50.08, 14.42`; null when it is none. */
export function parseLatLon(text) {
  const numbers = text.match(/-?\d+(?:\.\d+)?/g)?.map(Number) || [];
  const [lat, lon] = numbers;
  return numbers.length === 2 && Math.abs(lat) <= 85 && Math.abs(lon) <= 180 ? [lat, lon] : null;
}
