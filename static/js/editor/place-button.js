/** The button of a dialog that places photos by a file. */

import { h } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";

/** @param {Object} [attributes] additional attributes of the button */
export function placeButton(attributes = {}) {
  return h("button", { class: "button button--primary", type: "button", disabled: true, ...attributes }, t("Place"));
}

/** Show the number of photos that it would place. @param {HTMLButtonElement} button @param {number} n */
export function offer(button, n) {
  button.disabled = !n;
  button.textContent = n ? tn("Place {n} photo", "Place {n} photos", n) : t("Place");
}

/**
 * Place photos on a click; after an error the button is enabled again.
 * @param {HTMLButtonElement} button
 * @param {{place: function(): Promise<Object>, done: function(Object): Promise<void>, error: {show: function(?Error): void}}} how
 */
export function placeOnClick(button, { place, done, error }) {
  button.addEventListener("click", async () => {
    button.disabled = true;
    try {
      await done(await place());
    } catch (problem) {
      error.show(problem);
      button.disabled = false;
    }
  });
}
