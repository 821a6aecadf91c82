/** The dialog with the fields of a drawing; its points can be typed, so that no pointer is needed. */

import { busy, errorLine, field, openDialog } from "../../shared/dialogs.js";
import { h } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";

const RADIUS_M = 5;
const NUMBER = /[+-]?\d+(?:\.\d+)?/g;

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
  const points = h("textarea", { class: "input number", rows: 4, spellcheck: "false" }, drawing.points.map((point) => point.join(", ")).join("\n"));
  const error = errorLine();
  const end = h("button", { class: "button button--primary", type: "button" }, t("Save"));
  const again = redraw && h("button", { class: "button", type: "button", onclick: () => (dialog.close(), redraw()) }, t("Draw again"));
  const dialog = openDialog(drawing.id ? t("Edit {name}", { name: drawing.name }) : title(drawing.kind), [
    field(t("Name"), name),
    ...(area ? [
      field(t("Assigned to"), assigned),
      h("datalist", { id: "drawing-names" }, ...names.map((value) => h("option", { value }))),
      field(t("Radius in metres"), radius, t("What a track passes within this distance counts as covered.")),
    ] : []),
    field(t("Note"), note),
    field(t("Points"), points, t("One in each line: latitude, longitude in degrees.")),
    error,
  ], { actions: [again, end].filter(Boolean), cancels: true });
  end.addEventListener("click", () => busy(end, async () => {
    error.show(null);
    const known = pointsOf(points.value);
    if (!known) {
      error.show({ message: t("a line of the points does not have two numbers") });
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

/** Points of a text; null if a line has not exactly two numbers. @param {string} text @returns {?Array<[number, number]>} */
export function pointsOf(text) {
  const lines = text.split("\n").filter((line) => line.trim());
  const points = lines.map((line) => (line.match(NUMBER) || []).map(Number));
  return points.every((point) => point.length === 2) ? /** @type {Array<[number, number]>} */ (points) : null;
}
