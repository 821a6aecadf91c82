/** Messages in the corner of the page, and in place; screen readers read them out. */

import { h, icon } from "./dom.js";
import { t } from "./i18n.js";

const SHOWN_MS = 6000;

/**
 * Show a message.
 * @param {string} message
 * @param {Object} [options]
 * @param {"info"|"error"} [options.kind] an error stays until it is closed
 * @param {?string} [options.hint] what to do next
 * @param {{label: string, run: function(): void}} [options.action] one button
 * @returns {function(): void} removes the message
 */
export function toast(message, { kind = "info", hint = null, action = null } = {}) {
  const close = () => made.remove();
  const made = h(
    "div",
    { class: `toast toast--${kind}`, role: kind === "error" ? "alert" : "status" },
    h(
      "div",
      { class: "toast__text", "data-testid": kind === "error" ? "error-message" : null },
      h("div", {}, sentence(message)),
      hint && h("div", { class: "toast__hint" }, sentence(hint)),
    ),
    action && h("button", { class: "button button--quiet", type: "button", onclick: () => (close(), action.run()) }, action.label),
    h("button", { class: "icon-button", type: "button", "aria-label": t("Close"), onclick: close }, icon("close")),
  );
  place().append(made);
  if (kind !== "error") setTimeout(close, action ? 2 * SHOWN_MS : SHOWN_MS);
  return close;
}

/**
 * Show an error, except an abort or a required sign-in (401).
 * @param {{name?: string, message: string, status?: number, hint?: ?string, code?: string}} error
 */
export function toastError(error) {
  if (error.name === "AbortError" || error.status === 401) return;
  if (!("code" in error)) console.error(error);
  toast(error.message, { kind: "error", hint: error.hint });
}

/** A message in the panel. */
export function note(kind, text, hint = null, more = null) {
  const danger = kind === "danger";
  return h(
    "div",
    { class: `note note--${kind}`, role: danger ? "alert" : "status", "data-testid": danger ? "error-message" : null },
    icon(danger ? "warning" : "info"),
    h("div", { class: "grow" }, h("div", {}, text), hint && h("div", { class: "small" }, hint), more),
  );
}

/**
 * Make a sentence of a message: a capital letter in front.
 * @param {string} text
 * @returns {string}
 */
export function sentence(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** The container of messages; inside an open dialog, which would cover it otherwise. */
function place() {
  const parent = [...document.querySelectorAll("dialog[open]")].at(-1) || document.body;
  const there = parent.querySelector(":scope > .toasts");
  if (there) return there;
  const made = h("div", { class: "toasts" });
  parent.append(made);
  return made;
}
