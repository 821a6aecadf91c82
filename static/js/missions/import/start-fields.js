/** Number fields for the start of a robot, as an alternative to clicks on the preview. */

import { field } from "../../shared/dialogs.js";
import { h } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";

const DIGITS = [7, 7, 1];

/**
 * @param {import("./start-pose.js").StartPose} start
 * @param {{titled?: boolean}} [look] whether the title is shown
 * @returns {HTMLFieldSetElement}
 */
export function startFields(start, { titled = true } = {}) {
  const labels = [t("Latitude"), t("Longitude"), t("Heading, degrees")];
  const inputs = [90, 180, 360].map((most, place) => h("input", {
    class: "input number", type: "number", step: "any", min: -most, max: most, inputmode: "decimal", autocomplete: "off", "data-testid": `import-start-${place}`,
  }));
  const read = () => start.set(inputs.map((input) => (input.value === "" ? null : input.valueAsNumber)));
  const show = () => inputs.forEach((input, place) => {
    const value = start.values[place];
    if (input !== document.activeElement) input.value = value === null ? "" : String(Number(value.toFixed(DIGITS[place])));
  });
  for (const input of inputs) input.addEventListener("input", read);
  start.addEventListener("change", show);
  show();
  return h("fieldset", { class: "im-start" }, h("legend", { class: titled ? null : "visually-hidden" }, t("Start position of the robot")),
    h("div", { class: "mi-start" }, ...inputs.map((input, place) => field(labels[place], input))));
}
