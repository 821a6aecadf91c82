/** The dialog that prints a map: what is on the sheet, a preview, and the files. */

import { file } from "./api.js";
import { errorLine, field, openDialog } from "./dialogs.js";
import { h, icon } from "./dom.js";
import { t } from "./i18n.js";
import { floorSelect } from "./map/floor-switch.js";
import { debounce } from "./timing.js";

const PREVIEW_DPI = 80;
const PAUSE_MS = 300;
const RESOLUTIONS = [150, 200, 300];
const USUAL_DPI = 200;
const ALL_FLOORS = "all";

/**
 * Open the dialog.
 * @param {{slug: string, floors: import("./map/map-store.js").Floor[], floor: number}} map `floor`: initial choice, the floor that is shown
 * @param {{first: number, last: number}} [answers] range of ids of the user's own answers to print, too
 */
export function printDialog(map, answers) {
  const base = `/maps/${encodeURIComponent(map.slug)}/print`;
  const fields = sheetFields(map);
  const preview = h("img", { class: "print-preview__sheet", alt: t("Preview of the sheet"), "data-testid": "print-preview" });
  const frame = h("div", { class: "print-preview" }, preview);
  const error = errorLine();
  const links = ["pdf", "png"].map((form) => h("a", {
    class: `button${form === "pdf" ? " button--primary" : ""}`, download: true, "data-testid": `print-${form}`,
  }, icon("download"), form.toUpperCase()));
  const body = h("div", { class: "print-dialog" }, h("div", { class: "stack" }, ...fields.elements, error), frame);
  const dialog = openDialog(t("Print the map"), [body], { actions: links });
  dialog.classList.add("dialog--wide");
  let asked = 0;
  let shown = "";
  const show = async () => {
    const query = fields.query(answers);
    for (const [n, form] of ["pdf", "png"].entries()) links[n].href = `/api/v1${base}.${form}?${query}`;
    links[1].hidden = query.has("all_floors");
    query.delete("all_floors");
    query.set("dpi", String(PREVIEW_DPI));
    const mine = (asked += 1);
    frame.classList.add("print-preview--waits");
    try {
      const data = await file(`${base}.png?${query}`);
      if (mine !== asked) return;
      URL.revokeObjectURL(shown);
      preview.src = shown = URL.createObjectURL(data);
      error.show(null);
    } catch (problem) {
      if (mine === asked) error.show(problem);
    }
    if (mine === asked) frame.classList.remove("print-preview--waits");
  };
  const soon = debounce(show, PAUSE_MS);
  body.addEventListener("input", soon);
  dialog.addEventListener("close", () => URL.revokeObjectURL(shown));
  show();
}

/** The form's fields, and the query string that they produce. */
function sheetFields({ floors, floor }) {
  const chosen = {
    paper: choice([["a4", "A4"], ["a3", "A3"], ["letter", t("Letter")]]),
    orientation: choice([["auto", t("Automatic")], ["portrait", t("Portrait")], ["landscape", t("Landscape")]]),
    extent: choice([["image", t("The whole image")], ["photos", t("Around the photos")]]),
    labels: choice([["numbers", t("Numbers")], ["names", t("Names")], ["none", t("None")]]),
    ...(floors.length && { floor: floorSelect(floors, floor, [[ALL_FLOORS, t("All floors, a page each")]]) }),
    dpi: choice(RESOLUTIONS.map((dpi) => [String(dpi), t("{n} dpi", { n: dpi })]), String(USUAL_DPI)),
  };
  const titled = h("input", { class: "input", maxlength: 300, placeholder: t("Name of the map"), autocomplete: "off" });
  const credit = h("input", { class: "input", maxlength: 300, autocomplete: "off" });
  const headings = h("input", { type: "checkbox", checked: true });
  const points = h("input", { type: "checkbox" });
  const notes = h("input", { type: "checkbox", checked: true });
  const elements = [
    field(t("Title"), titled),
    ...(chosen.floor ? [field(t("Floor"), chosen.floor)] : []),
    h("div", { class: "print-dialog__pair" }, field(t("Paper"), chosen.paper), field(t("Orientation"), chosen.orientation)),
    h("div", { class: "print-dialog__pair" }, field(t("Part of the map"), chosen.extent), field(t("Labels"), chosen.labels)),
    h("div", { class: "stack stack--tight" },
      h("label", { class: "check small" }, headings, t("Directions of view")),
      h("label", { class: "check small" }, points, t("Control points")),
      h("label", { class: "check small" }, notes, t("Notes"))),
    field(t("Image credit"), credit),
    field(t("Resolution"), chosen.dpi),
  ];
  const query = (answers) => {
    const made = new URLSearchParams(Object.entries(chosen).map(([name, input]) => [name, input.value]));
    if (made.get("floor") === ALL_FLOORS) {
      made.set("all_floors", "true");
      made.set("floor", String(floor)); // for the preview
    }
    made.set("headings", String(headings.checked));
    made.set("control_points", String(points.checked));
    made.set("notes", String(notes.checked));
    if (titled.value.trim()) made.set("title", titled.value.trim());
    if (credit.value.trim()) made.set("attribution", credit.value.trim());
    if (answers) for (const [name, value] of Object.entries({ answers: true, mine: true, ...answers })) made.set(name, String(value));
    return made;
  };
  return { elements, query };
}

/** @param {string[][]} options value and label @param {string} [value] */
function choice(options, value) {
  const select = h("select", { class: "select" }, ...options.map(([key, words]) => h("option", { value: key }, words)));
  if (value) select.value = value;
  return select;
}
