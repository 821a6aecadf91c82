/** Which column of a CSV file holds what, for tables whose heads the server would not understand. */

import { h } from "../dom.js";
import { t } from "../i18n.js";

const HEAD_BYTES = 4096;
const MOST = 60;

/** What a column can hold, and the heads that say so by themselves. */
const FIELDS = {
  time: { label: () => t("Time"), usual: /^(time|timestamp|t|stamp|date|datetime|utc)(_s)?$/i },
  lat: { label: () => t("Latitude"), usual: /^lat(itude)?(_deg)?$/i },
  lon: { label: () => t("Longitude"), usual: /^(lon|lng|long)(gitude)?(_deg)?$/i },
  height_m: { label: () => t("Height"), usual: /^(height|altitude|alt|ele|elevation)(_m)?$/i },
  heading_deg: { label: () => t("Heading"), usual: /^(heading|course|bearing|yaw)(_deg)?$/i },
};

/** @returns {{element: HTMLElement, look: function(?File): Promise<void>, value: function(): string}} */
export function columnChoice() {
  const element = h("fieldset", { class: "mi-columns", hidden: true });
  const selects = new Map();
  return {
    element,
    async look(file) {
      element.hidden = true;
      selects.clear();
      if (!file || !/\.csv$/i.test(file.name)) return;
      const heads = headsOf(await file.slice(0, HEAD_BYTES).text());
      if (heads.length < 2) return;
      element.replaceChildren(h("legend", {}, t("Columns")), ...Object.keys(FIELDS).map((name) => choice(name, heads, selects)));
      element.hidden = false;
    },
    value() {
      const chosen = [...selects].filter(([, select]) => select.value).map(([name, select]) => [name, select.value]);
      return element.hidden ? "" : JSON.stringify(Object.fromEntries(chosen));
    },
  };
}

function choice(name, heads, selects) {
  const { label, usual } = FIELDS[name];
  const id = `column-${name}`;
  const select = h("select", { class: "select", id }, h("option", { value: "" }, "–"), ...heads.map((head) => h("option", { value: head }, head)));
  select.value = heads.find((head) => usual.test(head)) || "";
  selects.set(name, select);
  return h("div", { class: "field" }, h("label", { for: id }, label()), select);
}

function headsOf(text) {
  const first = text.replace(/^\ufeff/, "").split(/\r?\n/, 1)[0];
  const separator = [";", "\t", ","].find((one) => first.includes(one)) || ",";
  return first.split(separator).slice(0, MOST).map((head) => head.trim().replace(/^"|"$/g, "")).filter(Boolean);
}
