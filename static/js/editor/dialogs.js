/** Dialogs of the editor that hold more than a question. */

import { h } from "../dom.js";
import { t } from "../i18n.js";
import { sentence } from "../toast.js";

/**
 * Open a dialog; it is gone when it is closed.
 * @param {string} title
 * @param {Array<Node>} body
 * @param {{actions?: Array<Node>, beside?: boolean}} [options] `actions` stand beside the button that closes;
 *   `beside`: the image stays in sight and at hand
 * @returns {HTMLDialogElement}
 */
export function openDialog(title, body, { actions = [], beside = false } = {}) {
  const close = h("button", { class: "button", type: "button", onclick: () => dialog.close() }, actions.length ? t("Cancel") : t("Close"));
  const dialog = h(
    "dialog",
    { class: `dialog${beside ? " ed-dialog--beside" : ""}`, "aria-labelledby": "dialog-title" },
    h("div", { class: "dialog__body" },
      h("h2", { id: "dialog-title" }, title),
      ...body,
      h("div", { class: "dialog__actions" }, close, ...actions)),
  );
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.addEventListener("keydown", (event) => event.key === "Escape" && dialog.close());
  if (beside) dialog.show();
  else dialog.showModal();
  return dialog;
}

/** A labelled field. @param {string} label @param {HTMLElement} input @param {string} [hint] */
export function field(label, input, hint = "") {
  input.id ||= `field-${label.replace(/\W+/g, "-")}`;
  const told = hint && h("span", { class: "field__hint", id: `${input.id}-hint` }, hint);
  if (told) input.setAttribute("aria-describedby", told.id);
  return h("div", { class: "field" }, h("label", { for: input.id }, label), input, told);
}

/** A place for the reason why something in a dialog did not work. */
export function errorLine() {
  const line = h("p", { class: "dialog__error", role: "alert", "data-testid": "error-message", hidden: true });
  return Object.assign(line, {
    show(error) {
      line.hidden = !error;
      line.textContent = error ? [error.message, error.hint].filter(Boolean).map(sentence).join(". ") : "";
    },
  });
}
