/** Which column of a CSV file holds what, for tables whose heads the server would not understand. */

import { h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";

const HEAD_BYTES = 4096;
const MOST = 60;

/** What a column can hold, its units, the usual one first, and heads that say it by themselves. */
const FIELDS = [
  { name: "time", label: () => t("Time"), units: ["s", "ms", "us", "ns"], usual: /^(time|timestamp|t|stamp|datetime|utc)(_s)?$/i },
  { name: "lat", label: () => t("Latitude"), units: ["deg", "rad", "e7"], usual: /^(gps_)?lat(itude)?(_deg)?$/i },
  { name: "lon", label: () => t("Longitude"), units: ["deg", "rad", "e7"], usual: /^(gps_)?(lon|lng|long|longitude)(_deg)?$/i },
  { name: "height", label: () => t("Height"), units: ["m", "ft"], usual: /^(height|altitude|alt|ele|elevation)(_m)?$/i },
  { name: "heading", label: () => t("Heading"), units: ["deg", "rad"], usual: /^(heading|course|bearing|hdg)(_deg)?$/i },
  { name: "x", label: () => t("x, forward"), units: ["m", "mm"], usual: /^(pos_)?x(_m)?$/i },
  { name: "y", label: () => t("y, to the left"), units: ["m", "mm"], usual: /^(pos_)?y(_m)?$/i },
  { name: "yaw", label: () => t("Yaw"), units: ["rad", "deg"], usual: /^(yaw|theta)(_rad)?$/i },
  { name: "id", label: () => t("Object"), units: [], usual: /^(object_)?id$/i },
  { name: "class", label: () => t("Class"), units: [], usual: /^(class|kind|label)$/i },
];

/** @returns {{element: HTMLElement, look: function(?File): Promise<void>, value: function(): string}} */
export function columnChoice() {
  const element = h("details", { hidden: true });
  let rows = [];
  let changed = false;
  element.addEventListener("change", () => (changed = true));
  return {
    element,
    async look(file) {
      [rows, changed, element.hidden] = [[], false, true];
      if (!file || !/\.(csv|tsv)$/i.test(file.name)) return;
      const heads = headsOf(await file.slice(0, HEAD_BYTES).text());
      if (heads.length < 2) return;
      rows = FIELDS.map((field) => row(field, heads));
      const known = new Set(rows.filter(({ column }) => column.value).map(({ name }) => name));
      element.open = !(known.has("lat") && known.has("lon")) && !(known.has("x") && known.has("y"));
      element.replaceChildren(h("summary", {}, t("Columns of the table")), h("div", { class: "mi-columns" }, ...rows.map(({ box }) => box)));
      element.hidden = false;
    },
    /** As the server reads it; empty where it shall guess. */
    value() {
      const chosen = rows.filter(({ column }) => column.value);
      return changed ? chosen.map(({ name, column, unit }) => `${name}=${column.value}${unit ? `:${unit.value}` : ""}`).join(", ") : "";
    },
  };
}

function row({ name, label, units, usual }, heads) {
  const id = `column-${name}`;
  const options = heads.map((head, n) => h("option", { value: n + 1 }, head)); // by number: heads may hold any sign
  const column = h("select", { class: "select", id }, h("option", { value: "" }, "–"), ...options);
  const found = heads.findIndex((head) => usual.test(head));
  column.value = found < 0 ? "" : String(found + 1);
  const unit = units.length
    ? h("select", { class: "select select--short", "aria-label": t("Unit of {field}", { field: label() }) }, ...units.map((one) => h("option", {}, one)))
    : null;
  const box = h("div", { class: "field" }, h("label", { for: id }, label()), h("div", { class: "mi-column" }, column, unit));
  return { name, column, unit, box };
}

function headsOf(text) {
  const first = text.replace(/^\ufeff/, "").split(/\r?\n/, 1)[0];
  const separator = [";", "\t", ","].find((one) => first.includes(one)) || ",";
  return first.split(separator).slice(0, MOST).map((head) => head.trim().replace(/^"|"$/g, ""));
}
