/** Contents of a file and how to read it: sources, remarks, columns, axes. */

import { field } from "../../shared/dialogs.js";
import { h } from "../../shared/dom.js";
import { t, tn } from "../../shared/i18n.js";
import { sentence } from "../../shared/toast.js";
import { sourceColour } from "../colour-scales.js";
import { clockText, lengthText, sourceName, spanText } from "../format.js";
import { metresBetween } from "../track-points.js";
import { columnMapping } from "./column-mapping.js";
import { remarkList } from "./file-remarks.js";
import { keyOf } from "./staged-file.js";

const SOURCES = ["gps", "odometry", "visual", "manual"];

/** A part of the dialog; `element` stays the same while the file is shown. */
export class FilePanel {
  /** @param {import("./staged-file.js").StagedFile} file */
  constructor(file) {
    this.file = file;
    this._kind = h("p", { class: "im-kind" });
    this._sources = h("ul", { class: "im-sources", "aria-label": t("What is in the file") });
    this._remarks = h("div", { class: "stack stack--tight" });
    this._error = h("p", { class: "dialog__error", role: "alert", "data-testid": "reading-error", hidden: true });
    this._busy = h("progress", { class: "progress", "aria-label": t("Reading the file"), hidden: true });
    this._columns = h("details", { hidden: true });
    this._axes = axesField(file.reading.axes, (axes) => file.readAs({ axes }));
    const source = sourceField(file.reading.source, (name) => file.readAs({ source: name }));
    this.element = h("div", { class: "stack", "data-testid": "import-file" },
      this._kind, this._busy, this._sources, this._error, this._axes.element, this._columns, this._remarks,
      h("details", {}, h("summary", {}, t("Options")), h("div", { class: "stack" }, source, this._minMove())));
    this._render = this._render.bind(this);
    file.addEventListener("change", this._render);
    this._render();
  }

  _minMove() {
    const input = h("input", { class: "input", placeholder: "0.00001", autocomplete: "off", value: this.file.minMove });
    input.addEventListener("change", () => (this.file.minMove = input.value.trim()));
    return field(t("Skip points that moved less than"), input, t("Degrees, or metres such as 0.5m; 0 keeps every point. The distance always includes every point."));
  }

  close() {
    this.file.removeEventListener("change", this._render);
  }

  _render() {
    const { contents, state, error } = this.file;
    this._busy.hidden = state !== "reading";
    this._error.hidden = !error || !this.file.isUsable;
    if (error) this._error.textContent = [error.message, error.hint].filter(Boolean).map(sentence).join(". ");
    if (!contents || contents === this._shown) return;
    this._shown = contents;
    const counts = [sentence(contents.kind), contents.objects ? tn("{n} sighting of an object", "{n} sightings of objects", contents.objects) : null];
    this._kind.textContent = counts.filter(Boolean).join(" · ");
    this._sources.replaceChildren(...contents.sources.map((one) => this._source(one)));
    this._remarks.replaceChildren(...remarks(contents));
    if (contents.options.includes("axes")) this._axes.element.hidden = false;
    if (contents.table && this._columns.hidden) this._offerColumns(contents);
  }

  _offerColumns({ table, problem }) {
    this._columns.hidden = false;
    this._columns.open = Boolean(problem);
    this._columns.replaceChildren(h("summary", {}, t("Columns of the table")), ...columnMapping(table, (columns) => this.file.readAs({ columns })));
  }

  _source(one) {
    const tick = h("input", { type: "checkbox", "data-testid": "import-source" });
    tick.checked = !this.file.unwanted.has(keyOf(one));
    tick.addEventListener("change", () => this.file.choose(one, tick.checked));
    const swatch = h("span", { class: "mi-swatch", "aria-hidden": "true" });
    swatch.style.background = sourceColour(one.source);
    const badge = one.frame === "robot" && h("span", { class: "badge" }, t("in metres: needs a start"));
    return h("li", { class: "im-source" },
      h("label", { class: "check" }, tick, swatch, h("span", { class: "im-source__name" }, one.track ? `${sourceName(one.source)} · ${one.track}` : sourceName(one.source))),
      h("div", { class: "im-source__facts small soft number" }, ...factsOf(one).map((fact) => h("span", {}, fact)), badge));
  }
}

/** Facts about a source as texts. */
export function factsOf({ poses, first_time_s: first, last_time_s: last, frame, extent, headings, distance_m: way }) {
  return [
    tn("{n} position", "{n} positions", poses),
    first === null ? t("no times, only the order") : t("{time}, duration {duration}", { time: clockText(first), duration: spanText(last - first) }),
    t("distance {length}", { length: lengthText(way) }),
    t("extent {size}", { size: frame === "robot" ? sizeText(extent.x, extent.y) : sizeText(...spanOf(extent)) }),
    headings ? t("with headings") : null,
  ].filter(Boolean);
}

const sizeText = (a, b) => `${lengthText(a)} × ${lengthText(b)}`;

/** Extents from west to east and from south to north, metres. */
function spanOf({ south, west, north, east }) {
  const middle = (south + north) / 2;
  return [metresBetween([middle, west], [middle, east]), metresBetween([south, west], [north, west])];
}

function remarks({ problem, notes, skipped, doubts }) {
  const reason = problem && h("p", { class: "dialog__error", "data-testid": "import-problem" }, sentence(problem));
  return [reason, ...remarkList({ notes, skipped, doubts })].filter(Boolean);
}

function axesField(value, changed) {
  const choices = [["", t("detected")], ["robot", t("robot: x forward, y left, z up")], ["camera", t("camera: x right, y down, z forward")],
    ["ned", t("x north or forward, y east or right, z down")]];
  const select = h("select", { class: "select", "data-testid": "import-axes" }, ...choices.map(([name, label]) => h("option", { value: name }, label)));
  select.value = value;
  select.addEventListener("change", () => changed(select.value));
  const element = field(t("Axes"), select);
  element.hidden = true;
  return { element };
}

function sourceField(given, changed) {
  const select = h("select", { class: "select", "data-testid": "import-as" },
    h("option", { value: "" }, t("as in the file")), ...SOURCES.map((name) => h("option", { value: name }, sourceName(name))));
  select.value = given;
  select.addEventListener("change", () => changed(select.value));
  return field(t("Source of the positions"), select);
}
