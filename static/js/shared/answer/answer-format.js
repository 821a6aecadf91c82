/** Formats colours, numbers and angles of an answer for display. */

import { locale, t } from "../i18n.js";

/** Colours of the pictures: `scale` and `text` by percent, `inlier`, `outlier`, `ink`, `truth`. */
export const colours = JSON.parse(document.getElementById("colours").textContent);

const WINDS = 8;

/** Fill and text colour of a probability. @param {number} probability 0 to 1 */
export function probabilityColours(probability) {
  const percent = Math.round(Math.min(Math.max(probability, 0), 1) * 100);
  return { fill: colours.scale[percent], text: colours.text[percent] };
}

/** A number rounded to the given digits. */
export function numberText(value, digits = 0) {
  return value.toLocaleString(locale, { maximumFractionDigits: digits });
}

/** A length: in metres if the map has a scale, else in pixels. */
export function lengthText(metres, pixels) {
  if (metres === null || metres === undefined) return t("{n} px", { n: numberText(pixels, pixels < 10 ? 1 : 0) });
  return t("{n} m", { n: numberText(metres, metres < 10 ? 1 : 0) });
}

/** A heading with the name of its direction. @param {number} degrees clockwise from north */
export function headingText(degrees) {
  const names = [t("north"), t("north-east"), t("east"), t("south-east"), t("south"), t("south-west"), t("west"), t("north-west")];
  const turned = ((degrees % 360) + 360) % 360;
  return t("{n}° ({wind})", { n: Math.round(turned) % 360, wind: names[Math.round((turned / 360) * WINDS) % WINDS] });
}
