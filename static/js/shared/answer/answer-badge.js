/** An answer as a badge for lists: the probability of its first place, hollow if that is faint, or "not here". */

import { h } from "../dom.js";
import { percentText } from "../format.js";
import { t } from "../i18n.js";
import { probabilityColours } from "./answer-format.js";
import { isOffMap, verdictOf } from "./query-session.js";
import { isFaint, verdictText } from "./verdict.js";

/** @returns {HTMLElement} with the verdict as its tooltip */
export function answerBadge(answer) {
  const [first] = answer.hypotheses;
  const elsewhere = isOffMap(answer);
  const none = verdictOf(answer) === "nothing_to_see" ? t("no place") : t("not here");
  const badge = h("span", { class: "badge", title: verdictText(answer) }, elsewhere ? none : percentText(first.probability));
  if (elsewhere || isFaint(answer, first.probability)) {
    badge.classList.add("badge--hollow");
    return badge;
  }
  const { fill, text } = probabilityColours(first.probability);
  Object.assign(badge.style, { backgroundColor: fill, color: text });
  return badge;
}
