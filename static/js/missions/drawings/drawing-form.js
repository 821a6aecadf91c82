/** The dialog with the fields of a drawing; its points can be typed, so that no pointer is needed. */

import { busy, errorLine, field, openDialog } from "../../shared/dialogs.js";
import { h } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";
import { parsePosition } from "../../shared/map/grids.js";
import { placeToCopy } from "../../shared/map/positions.js";

const RADIUS_M = 5;

/**
 * Ask for the fields of a drawing.
 * @param {Object} drawing as known so far: `kind`, `points`, perhaps the rest
 * @param {Object} how
 * @param {string[]} how.names suggested as assignees of an area
 * @param {function(Object): Promise<*>} how.save gets the fields; an error stays in the dialog
 * @param {?function(): void} [how.redraw] draws the shape again on the map
 */
export function drawingDialog(drawing, { names, save, redraw = null }) {
  const area = drawing.kind === "area";
  const name = h("input", { class: "input", maxlength: 120, value: drawing.name || "", required: true, autocomplete: "off" });
  const assigned = h("input", { class: "input", maxlength: 120, value: drawing.assigned || "", list: "drawing-names", autocomplete: "off" });
  const radius = h("input", { class: "input", type: "number", min: 0.5, max: 200, step: "any", value: drawing.radius_m ?? RADIUS_M });
  const note = h("textarea", { class: "input", rows: 2, maxlength: 2000 }, drawing.note || "");
  const points = h("textarea", { class: "input number", rows: 4, spellcheck: "false" }, pointsText(drawing.points));
  const error = errorLine();
  const end = h("button", { class: "button button--primary", type: "button" }, t("Save"));
  const again = redraw && h("button", { class: "button", type: "button", onclick: () => (dialog.close(), redraw()) }, t("Draw again"));
  const dialog = openDialog(drawing.id ? t("Edit {name}", { name: drawing.name }) : title(drawing.kind), [
    field(t("Name"), name),
    ...(area ? [
      field(t("Assigned to"), assigned),
      h("datalist", { id: "drawing-names" }, ...names.map((value) => h("option", { value }))),
      field(t("How far to each side one sees, metres"), radius, t("What a track passes within this distance counts as covered.")),
    ] : []),
    field(t("Note"), note),
    field(t("Points"), points, t("One in each line: latitude and longitude in degrees, UTM or MGRS.")),
    error,
  ], { actions: [again, end].filter(Boolean), cancels: true });
  end.addEventListener("click", () => busy(end, async () => {
    error.show(null);
    const { points: known, wrong } = pointsOf(points.value, drawing.points);
    if (wrong !== null) {
      error.show({ message: t("“{line}” is not a position", { line: wrong }) });
      points.focus();
      return;
    }
    const fields = { name: name.value, note: note.value, points: known };
    if (area) Object.assign(fields, { assigned: assigned.value, radius_m: Number(radius.value) });
    try {
      await save(fields);
      dialog.close();
    } catch (problem) {
      if (problem.status === undefined) throw problem;
      error.show(problem);
    }
  }));
  name.focus();
}

function title(kind) {
  return { area: t("New search area"), line: t("New line"), marker: t("New marker") }[kind];
}

/** Points in the chosen notation, one in each line. @param {Array<[number, number]>} points latitudes and longitudes */
export const pointsText = (points) => points.map(placeToCopy).join("\n");

/**
 * Points of a text in any notation. Lines that were not changed are points as they were: a notation may round them.
 * @param {string} text
 * @param {Array<[number, number]>} before points that the text was made of
 * @returns {{points: Array<[number, number]>, wrong: ?string}} `wrong`: the first line that is not a position
 */
export function pointsOf(text, before = []) {
  const exact = new Map(before.map((point) => /** @type {[string, [number, number]]} */ ([placeToCopy(point), point])));
  const lines = text.split("\n").map((line) => line.trim()).filter(Boolean);
  const points = lines.map((line) => exact.get(line) ?? parsePosition(line));
  return { points, wrong: lines.find((_, n) => !points[n]) ?? null };
}
