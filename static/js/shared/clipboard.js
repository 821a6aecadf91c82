/** Copying text. */

import { h, icon } from "./dom.js";
import { t } from "./i18n.js";
import { toast } from "./toast.js";

/**
 * Copy text to the clipboard; without https there is no clipboard, and the text is shown instead.
 * @param {string} text
 * @param {string} confirmation
 */
export async function copy(text, confirmation) {
  try {
    await navigator.clipboard.writeText(text);
    toast(confirmation);
  } catch {
    toast(text);
  }
}

/**
 * A button that shows a text and copies it.
 * @param {HTMLElement} shown
 * @param {function(): string} text what to copy, when it is pressed
 */
export function copyButton(shown, text) {
  const run = () => copy(text(), t("Copied: {text}", { text: text() }));
  return h("button", { class: "copy-text", type: "button", title: t("Copy"), onclick: run }, shown, h("span", { class: "visually-hidden" }, t("Copy")), icon("copy"));
}
