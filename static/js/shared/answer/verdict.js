/** The answer in one sentence, by the server's verdict, and which places are improbable. */

import { t } from "../i18n.js";
import { verdictOf } from "./query-session.js";

const LITTLE = 0.05;

/** The sentence above the list. */
export function verdictText(answer) {
  const area = answer.hypotheses[0]?.kind === "area";
  return {
    nothing_to_see: () => t("Nothing to recognise in this photo: it is too dark, too plain or too blurred."),
    off_map: () => t("Probably not on this map."),
    perhaps_off_map: () => t("Uncertain, perhaps not on this map."),
    perhaps_place: () => (area ? t("Uncertain, perhaps in area 1.") : t("Uncertain, perhaps at place 1.")),
    place: () => (area ? t("In area 1.") : t("At place 1.")),
  }[verdictOf(answer)]();
}

/** Whether a place is so improbable that it is folded and drawn small. */
export function isMinor({ off_map_probability: off }, probability) {
  return off !== null && probability < LITTLE;
}

/** Whether a place is drawn hollow: something else leads, or it is improbable itself. */
export function isFaint(answer, probability) {
  const { hypotheses: [first], off_map_probability: off, other_probability: other } = answer;
  return isMinor(answer, probability) || (off !== null && Math.max(off, other) > first.probability);
}
