/** The button of a dialog that places photos by a file. */

import { h } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";

/** @param {Object} [attributes] further ones of the button */
export function placeButton(attributes = {}) {
  return h("button", { class: "button button--primary", type: "button", disabled: true, ...attributes }, t("Place"));
}

/** Say how many photos it would place. @param {HTMLButtonElement} button @param {number} n */
export function offer(button, n) {
  button.disabled = !n;
  button.textContent = n ? tn("Place {n} photo", "Place {n} photos", n) : t("Place");
}

/**
 * Place photos when it is pressed; after an error it can be pressed again.
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
