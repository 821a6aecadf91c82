/** Mapping of the columns of a table: as detected by the server, and changeable. */

import { h } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";

/** @type {Array<{name: string, label: function(): string, units: string[]}>} fields that are offered, the usual unit first */
const FIELDS = [
  { name: "time", label: () => t("Time"), units: ["s", "ms", "us", "ns", "min", "h", "excel"] },
  { name: "date", label: () => t("Date"), units: ["ymd", "dmy", "mdy"] },
  { name: "lat", label: () => t("Latitude"), units: ["deg", "rad", "mrad", "min", "e7", "e6"] },
  { name: "lon", label: () => t("Longitude"), units: ["deg", "rad", "mrad", "min", "e7", "e6"] },
  { name: "height", label: () => t("Height"), units: ["m", "cm", "mm", "km", "ft", "in", "yd"] },
  { name: "heading", label: () => t("Heading"), units: ["deg", "rad", "mrad", "cdeg"] },
  { name: "x", label: () => t("x, forward"), units: ["m", "cm", "mm", "km", "ft", "in", "yd"] },
  { name: "y", label: () => t("y, to the left"), units: ["m", "cm", "mm", "km", "ft", "in", "yd"] },
  { name: "z", label: () => t("z, up"), units: ["m", "cm", "mm", "km", "ft", "in", "yd"] },
  { name: "yaw", label: () => t("Yaw"), units: ["rad", "deg", "mrad"] },
  { name: "accuracy", label: () => t("Accuracy"), units: ["m", "cm", "mm", "ft"] },
  { name: "track", label: () => t("Track"), units: [] },
  { name: "id", label: () => t("Object"), units: [] },
  { name: "class", label: () => t("Class"), units: [] },
];

/**
 * Write the mapping in the server's syntax.
 * @param {Array<{name: string, column: string, unit: string}>} rows `column` by number, as headers may contain any character; empty: none
 */
export function mappingText(rows) {
  return rows.filter(({ column }) => column).map(({ name, column, unit }) => `${name}=${column}${unit ? `:${unit}` : ""}`).join(", ");
}

/** The rows of a mapping: the offered fields, and any others that the server has found. */
export function rowsOf({ columns, units }) {
  const known = new Map(FIELDS.map((field) => [field.name, field]));
  const names = [...known.keys(), ...Object.keys(columns).filter((name) => !known.has(name))];
  return names.map((name) => {
    const field = known.get(name);
    const unit = units[name] ?? field?.units[0] ?? "";
    const offered = field?.units ?? [];
    return {
      name,
      label: field?.label() ?? name,
      units: unit && !offered.includes(unit) ? [unit, ...offered] : offered,
      column: name in columns ? String(columns[name] + 1) : "",
      unit,
    };
  });
}

/**
 * @param {Object} table as returned by the server
 * @param {function(string): void} changed called with the text of the mapping
 * @returns {Array<Node>}
 */
export function columnMapping(table, changed) {
  const heads = table.header.length ? table.header : table.rows[0]?.map((_, n) => t("column {n}", { n: n + 1 })) ?? [];
  const rows = rowsOf(table);
  const update = () => changed(mappingText(rows));
  const boxes = rows.map((row) => fieldOf(row, heads, update));
  return [sample(heads, table.rows), h("div", { class: "columns" }, ...boxes)];
}

function fieldOf(row, heads, update) {
  const id = `column-${row.name}`;
  const options = heads.map((head, n) => h("option", { value: n + 1 }, head || t("column {n}", { n: n + 1 })));
  const column = h("select", { class: "select", id, "data-testid": id }, h("option", { value: "" }, "–"), ...options);
  column.value = row.column;
  column.addEventListener("change", () => {
    row.column = column.value;
    update();
  });
  const unit = row.units.length > 1 ? unitOf(row, update) : null;
  return h("div", { class: "field" }, h("label", { for: id }, row.label), h("div", { class: "columns__one" }, column, unit));
}

function unitOf(row, update) {
  const label = t("Unit of {field}", { field: row.label });
  const unit = h("select", { class: "select select--short", "aria-label": label }, ...row.units.map((one) => h("option", {}, one)));
  unit.value = row.unit;
  unit.addEventListener("change", () => {
    row.unit = unit.value;
    if (row.column) update();
  });
  return unit;
}

/** The first rows, which help to interpret unclear headers. */
function sample(heads, rows) {
  const line = (cells, tag) => h("tr", {}, ...cells.map((cell) => h(tag, tag === "th" ? { scope: "col" } : {}, cell)));
  return h("div", { class: "im-sample", tabindex: 0, role: "group", "aria-label": t("First rows of the table") },
    h("table", { class: "table small number" }, h("thead", {}, line(heads, "th")), h("tbody", {}, ...rows.slice(0, 3).map((cells) => line(cells, "td")))));
}
