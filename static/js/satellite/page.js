/** Data of this page, and messages that survive a reload. */

import { byId, h, icon, queryAll } from "../shared/dom.js";
import { tn } from "../shared/i18n.js";
import { keepNotes, takeNotes } from "../shared/kept-notes.js";
import { sentence } from "../shared/toast.js";

/** Data of the page: `slug`, `revision`, `satellite`, `earth`, `services`, `photos`, `placed`, `failure`, `canEdit`. */
export const page = JSON.parse(document.getElementById("page").textContent);

/** Address of this map in the API. */
export const base = `/maps/${page.slug}`;

/**
 * Reload the page and show messages at its top.
 * @param {import("../shared/kept-notes.js").Note[]} notes
 */
export function reloadWith(notes) {
  keepNotes(notes);
  location.reload();
}

/** Go on to the editor, which shows the messages. @param {import("../shared/kept-notes.js").Note[]} notes */
export function toEditor(notes) {
  keepNotes(notes);
  location.assign(`${base}/edit`);
}

/** Show the messages that were kept for this page. */
export function showKeptNotes() {
  const kept = takeNotes();
  if (!kept.length) return;
  history.scrollRestoration = "manual"; // the messages are at the top, but the pressed button is far below
  scrollTo(0, 0);
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
 * @param {function(string): void} chosen called with the value of the pressed button
 * @returns {function(string): void} chooses one
 */
export function panels(attribute, chosen) {
  const buttons = queryAll(`[data-${attribute}]`, HTMLButtonElement);
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

/** Notes on photos that were placed, or taken off the map, with a new image. @returns {import("../shared/kept-notes.js").Note[]} */
export function movedPhotoNotes(fromTray, toTray) {
  /** @type {import("../shared/kept-notes.js").Note[]} */
  const notes = [];
  if (fromTray) notes.push({ kind: "success", text: tn("{n} photo was placed by its GPS.", "{n} photos were placed by their GPS.", fromTray) });
  if (toTray) notes.push({ kind: "warning", text: tn("{n} photo went back to the tray.", "{n} photos went back to the tray.", toTray) });
  return notes;
}
