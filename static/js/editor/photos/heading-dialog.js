/** The dialog to set the headings of many photos. */

import { field, openDialog } from "../../shared/dialogs.js";
import { h } from "../../shared/dom.js";
import { t, tn } from "../../shared/i18n.js";
import { imageAngle, wholeTurn } from "../../shared/map/coords.js";

/**
 * Headings of photos taken while walking: each towards the next one, the last like the one before it.
 * @param {number[]} ids by time
 * @param {import("../../shared/map/map-store.js").MapStore} store
 * @returns {Map<number, number>} by id; empty if the placed photos are all at one position
 */
export function headingsAlong(ids, store) {
  const placed = ids.filter((id) => store.isPlaced(id)).map((id) => ({ id, at: store.position(id) }));
  const found = new Map();
  placed.forEach(({ id, at }, n) => {
    const next = placed.slice(n + 1).find((one) => one.at[0] !== at[0] || one.at[1] !== at[1]);
    if (next) found.set(id, wholeTurn(imageAngle(at, next.at) - store.georeference.north(at)));
  });
  const last = [...found.values()].at(-1);
  if (last !== undefined) for (const { id } of placed) if (!found.has(id)) found.set(id, last);
  return found;
}

/**
 * Ask for the headings of photos and set them.
 * @param {import("../commands.js").Commands} commands
 * @param {number[]} ids by time
 */
export function headingDialog(commands, ids) {
  const { store } = commands;
  const along = headingsAlong(ids, store);
  const way = h("select", { class: "select", "data-testid": "heading-way" },
    h("option", { value: "one" }, t("The same for all")),
    h("option", { value: "along", disabled: !along.size }, t("Along the way, each towards the next photo")),
    h("option", { value: "none" }, t("None: remove the headings")));
  const degrees = h("input", { class: "input", type: "number", min: -360, max: 360, step: "any", required: true, inputmode: "decimal" });
  const asked = field(t("Degrees clockwise from north"), degrees);
  way.addEventListener("change", () => (asked.hidden = way.value !== "one"));
  const set = h("button", { class: "button button--primary", type: "button" }, t("Set the headings"));
  const title = tn("Heading of {n} photo", "Headings of {n} photos", ids.length);
  const dialog = openDialog(title, [field(t("Heading"), way), asked], { actions: [set] });
  set.addEventListener("click", () => {
    if (way.value === "one" && !degrees.reportValidity()) return;
    const same = way.value === "one" ? wholeTurn(Number(degrees.value)) : null;
    commands.turnAll(way.value === "along" ? along : new Map(ids.map((id) => [id, same])));
    dialog.close();
  });
}
