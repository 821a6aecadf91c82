/** Dialogs: a question, a line of text, or a custom form. */

import { h, targetOf } from "./dom.js";
import { t } from "./i18n.js";
import { sentence } from "./toast.js";

/**
 * Ask whether to continue.
 * @param {Object} words
 * @param {string} words.title
 * @param {string} [words.text]
 * @param {string} words.action on the button
 * @param {boolean} [words.danger] whether the action cannot be undone
 * @returns {Promise<boolean>}
 */
export function confirmDialog({ title, text = "", action, danger = false }) {
  return new Promise((resolve) => {
    const dialog = frame(title, text && h("p", { class: "soft" }, text), { action, danger });
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"));
    show(dialog);
  });
}

/**
 * Ask for a line of text and submit it; if that fails, the dialog stays open and shows the error.
 * @param {Object} words
 * @param {string} words.title
 * @param {string} words.label of the field
 * @param {string} [words.value] initial value
 * @param {string} words.action on the button
 * @param {string} [words.testid] of the field
 * @param {number} [words.maxlength]
 * @param {function(string): Promise<void>} submit
 */
export function askDialog({ title, label, value = "", action, testid, maxlength = 120 }, submit) {
  const input = h("input", {
    class: "input", id: "ask-input", value, maxlength, required: true, autocomplete: "off", "data-testid": testid,
  });
  const error = h("p", { class: "dialog__error", role: "alert", "data-testid": "error-message", hidden: true });
  const body = h("div", { class: "field" }, h("label", { for: "ask-input" }, label), input, error);
  const dialog = frame(title, body, { action });
  dialog.querySelector("form").addEventListener("submit", async (event) => {
    event.preventDefault();
    await busy(event.submitter, async () => {
      try {
        await submit(input.value);
        dialog.close();
      } catch (problem) {
        error.textContent = [problem.message, problem.hint].filter(Boolean).map(sentence).join(". ");
        error.hidden = false;
        input.focus();
      }
    });
  });
  show(dialog);
  input.select();
}

/**
 * Disable a button until an action has finished.
 * @param {?EventTarget} button the pressed button, or null
 * @param {function(): Promise<void>} run
 */
export async function busy(button, run) {
  if (button instanceof HTMLButtonElement) button.disabled = true;
  try {
    await run();
  } finally {
    if (button instanceof HTMLButtonElement) button.disabled = false;
  }
}

function frame(title, body, { action, danger = false }) {
  const kind = danger ? "button--danger" : "button--primary";
  return h(
    "dialog",
    { class: "dialog", "aria-labelledby": "dialog-title" },
    h(
      "form",
      { class: "dialog__body", method: "dialog" },
      h("h2", { id: "dialog-title" }, title),
      body,
      h(
        "div",
        { class: "dialog__actions" },
        h("button", { class: "button", type: "button", onclick: (event) => targetOf(event).closest("dialog").close() }, t("Cancel")),
        h("button", { class: `button ${kind}`, value: "yes", type: "submit" }, action),
      ),
    ),
  );
}

function show(dialog) {
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
}

/**
 * Open a dialog, which is removed when it is closed.
 * @param {string} title
 * @param {Array<Node>} body
 * @param {{actions?: Array<Node>, cancels?: boolean, modeless?: boolean}} [options] `actions` are buttons next to the one that closes,
 *   which `cancels` the only thing the dialog does; `modeless`: the page stays visible and usable
 * @returns {HTMLDialogElement}
 */
export function openDialog(title, body, { actions = [], cancels = actions.length > 0, modeless = false } = {}) {
  const close = h("button", { class: "button", type: "button", onclick: () => dialog.close() }, cancels ? t("Cancel") : t("Close"));
  const dialog = h(
    "dialog",
    { class: `dialog${modeless ? " ed-dialog--beside" : ""}`, "aria-labelledby": "dialog-title" },
    h("div", { class: "dialog__body" },
      h("h2", { id: "dialog-title" }, title),
      ...body,
      h("div", { class: "dialog__actions" }, close, ...actions)),
  );
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    event.preventDefault(); // a dialog below this one stays open
    dialog.close();
  });
  if (modeless) dialog.show();
  else dialog.showModal();
  return dialog;
}

/** A labelled field. @param {string} label @param {HTMLElement} input @param {string} [hint] */
export function field(label, input, hint = "") {
  input.id ||= `field-${label.replace(/\W+/g, "-")}`;
  const description = hint && h("span", { class: "field__hint", id: `${input.id}-hint` }, hint);
  if (description) input.setAttribute("aria-describedby", description.id);
  return h("div", { class: "field" }, h("label", { for: input.id }, label), input, description);
}

/** A line for error messages in a dialog. */
export function errorLine() {
  const line = h("p", { class: "dialog__error", role: "alert", "data-testid": "error-message", hidden: true });
  return Object.assign(line, {
    show(error) {
      line.hidden = !error;
      line.textContent = error ? [error.message, error.hint].filter(Boolean).map(sentence).join(". ") : "";
    },
  });
}
