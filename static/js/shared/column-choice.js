/** Choice of the columns of a table, for tables whose headers the server would not recognise. */

import { h } from "./dom.js";
import { t } from "./i18n.js";

const HEAD_BYTES = 4096;
const MOST = 60;
const NO_HEADER = /^("?sep=.|# |$)/i; // a line for Excel, or a comment
const SEPARATORS = [";", "\t", ",", "|", " "];

/**
 * @typedef {Object} Field what a column can hold
 * @property {string} name
 * @property {function(): string} label
 * @property {string[]} units the usual one first
 * @property {RegExp} usual headers that are recognised
 * @property {boolean} [needed] in addition to a position
 */

/**
 * Let a person assign the columns; the choice is folded if the headers are recognised.
 *
 * @param {Field[]} fields
 * @param {function(File, string): boolean} isTable whether a file with this beginning is a table
 * @returns {{element: HTMLElement, look: function(?File): Promise<void>, complete: function(): boolean, value: function(): string}}
 */
export function columnChoice(fields, isTable) {
  const element = h("details", { hidden: true });
  let rows = [];
  let changed = false;
  element.addEventListener("change", () => (changed = true));
  const complete = () => {
    const known = new Set(rows.filter(({ column }) => column.value).map(({ name }) => name));
    const placed = (known.has("lat") && known.has("lon")) || (known.has("x") && known.has("y"));
    return !rows.length || (placed && fields.every(({ name, needed }) => !needed || known.has(name)));
  };
  return {
    element,
    /** Whether a table can be read with this choice. */
    complete,
    async look(file) {
      [rows, changed, element.hidden] = [[], false, true];
      const text = file ? await file.slice(0, HEAD_BYTES).text() : "";
      const heads = file && isTable(file, text) ? headsOf(text) : [];
      if (heads.length < 2) return;
      rows = fields.map((field) => row(field, heads));
      element.open = !complete();
      element.replaceChildren(h("summary", {}, t("Columns of the table")), h("div", { class: "columns" }, ...rows.map(({ box }) => box)));
      element.hidden = false;
    },
    /** The choice in the server's syntax; empty to let the server guess. */
    value() {
      const chosen = rows.filter(({ column }) => column.value);
      return changed ? chosen.map(({ name, column, unit }) => `${name}=${column.value}${unit ? `:${unit.value}` : ""}`).join(", ") : "";
    },
  };
}

function row({ name, label, units, usual }, heads) {
  const id = `column-${name}`;
  const options = heads.map((head, n) => h("option", { value: n + 1 }, head)); // by number: headers may contain any character
  const column = h("select", { class: "select", id }, h("option", { value: "" }, "–"), ...options);
  const found = heads.findIndex((head) => usual.test(plain(head)));
  column.value = found < 0 ? "" : String(found + 1);
  const unit = units.length > 1
    ? h("select", { class: "select select--short", "aria-label": t("Unit of {field}", { field: label() }) }, ...units.map((one) => h("option", {}, one)))
    : null;
  const box = h("div", { class: "field" }, h("label", { for: id }, label()), h("div", { class: "columns__one" }, column, unit));
  return { name, column, unit, box };
}

/** A header without its unit in brackets, its words joined as on the server. */
function plain(head) {
  return head.replace(/\s*[[(][^)\]]*[\])]$/, "").replace(/[\s.-]+/g, "_");
}

function headsOf(text) {
  const lines = text.replace(/^\ufeff/, "").split(/\r?\n/).map((line) => line.trim());
  const first = lines.find((line) => !NO_HEADER.test(line)) || "";
  const separator = SEPARATORS.find((one) => first.includes(one)) || ",";
  return first.split(separator).slice(0, MOST).map((head) => head.trim().replace(/^"|"$/g, ""));
}
