/** Texts for a plan of photos to take. */

import { t } from "./i18n.js";

const STEP_DEG = 45;

/** Name of a direction. @param {number} heading degrees clockwise from north */
export function directionName(heading) {
  const names = [t("north"), t("north-east"), t("east"), t("south-east"), t("south"), t("south-west"), t("west"), t("north-west")];
  return names[Math.round((((heading % 360) + 360) % 360) / STEP_DEG) % names.length];
}

/** Directions to look in at a spot. @param {number[]} headings */
export function lookText(headings) {
  return headings.length ? t("Look {directions}", { directions: headings.map(directionName).join(", ") }) : t("Look all around");
}

/** Why photos are wanted at a spot. @param {string} reason name in the API */
export function reasonText(reason) {
  if (reason === "not-recognised") return t("photos here were not recognised");
  if (reason === "one-direction") return t("seen in one direction only");
  return reason === "direction" ? t("no photo looks this way") : t("few photos near here");
}
