/** An answer in one badge, for lists: its first place in its colour, hollow where that does not lead, or "not here". */

import { h } from "../dom.js";
import { percentText } from "../format.js";
import { t } from "../i18n.js";
import { probabilityColours } from "./answer-format.js";
import { isOffMap } from "./query-session.js";
import { isFaint, verdictText } from "./verdict.js";

/** @returns {HTMLElement} with the sentence of the answer as its tooltip */
export function answerBadge(answer) {
  const [first] = answer.hypotheses;
  const elsewhere = isOffMap(answer);
  const badge = h("span", { class: "badge", title: verdictText(answer) }, elsewhere ? t("not here") : percentText(first.probability));
  if (elsewhere || isFaint(answer, first.probability)) {
    badge.classList.add("badge--hollow");
    return badge;
  }
  const { fill, text } = probabilityColours(first.probability);
  Object.assign(badge.style, { backgroundColor: fill, color: text });
  return badge;
}
