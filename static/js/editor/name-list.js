/** A folded list of lines under a title with their number. */

import { h } from "../shared/dom.js";
import { labelled, tn } from "../shared/i18n.js";

const SHOWN = 50;

/**
 * @param {string} title
 * @param {string[]} lines
 * @returns {?HTMLElement} null if there are none
 */
export function nameList(title, lines) {
  if (!lines.length) return null;
  const rows = lines.slice(0, SHOWN).map((line) => h("li", {}, line));
  const more = lines.length - rows.length;
  if (more > 0) rows.push(h("li", { class: "soft" }, tn("and {n} more", "and {n} more", more)));
  return h("details", {}, h("summary", {}, labelled(title, lines.length)), h("ul", { class: "small" }, ...rows));
}
