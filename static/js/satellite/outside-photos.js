/** Asks how to treat placed photos that would be outside a new image. */

import { h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { sentence } from "../shared/toast.js";

const ASKED = /would lie outside/;

/**
 * Ask what to do next after an image was refused because of photos outside of it.
 * @param {{message: string}} error
 * @returns {Promise<?{scale: boolean, tray: boolean}>} null for other errors, or if cancelled
 */
export function outsideChoices(error) {
  if (!ASKED.test(error.message)) return Promise.resolve(null);
  return new Promise((resolve) => {
    const choose = (choice) => () => {
      answer = choice;
      dialog.close();
    };
    let answer = null;
    const button = (label, choice, kind = "") =>
      h("button", { class: `button button--wide ${kind}`, type: "button", onclick: choose(choice) }, label);
    const dialog = h(
      "dialog",
      { class: "dialog", "aria-labelledby": "outside-title" },
      h(
        "div",
        { class: "dialog__body" },
        h("h2", { id: "outside-title" }, t("Photos outside the image")),
        h("p", {}, sentence(error.message)),
        h(
          "div",
          { class: "stack stack--tight" },
          button(t("Scale all positions with the image"), { scale: true, tray: false }),
          button(t("Move the photos outside back to the tray"), { scale: false, tray: true }),
          button(t("Keep the old image"), null, "button--quiet"),
        ),
      ),
    );
    dialog.addEventListener("close", () => {
      dialog.remove();
      resolve(answer);
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}
