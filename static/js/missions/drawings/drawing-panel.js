/** The list of search areas, lines and markers, with buttons to draw, assign, mark and delete them. */

import { busy, confirmDialog } from "../../shared/dialogs.js";
import { byId, h, icon, queryAll } from "../../shared/dom.js";
import { locale, t } from "../../shared/i18n.js";
import { rafThrottle } from "../../shared/timing.js";
import { toast, toastError } from "../../shared/toast.js";
import { clockText, lengthText, numberText, percentText, trackName } from "../format.js";
import { drawingDialog } from "./drawing-form.js";
import { COLOURS, stateOf } from "./drawing-store.js";
import { shapesOf } from "./shapes-of-file.js";

const HECTARE_M2 = 10_000;

/**
 * Keep the list up to date, and connect the buttons above it.
 * @param {import("./drawing-store.js").DrawingStore} drawings
 * @param {function(Array<[number, number]>): void} look shows an area of the map
 */
export function showDrawings(drawings, look) {
  const list = byId("drawings");
  const render = rafThrottle(() => {
    const focused = document.activeElement?.closest("#drawings [data-does]");
    const key = focused && `li[data-id="${focused.closest("li").dataset.id}"] [data-does="${focused.getAttribute("data-does")}"]`;
    const open = drawings.list.filter((one) => one.kind === "area" && !one.searched).length;
    byId("tab-areas-count").textContent = open ? open.toLocaleString(locale) : "";
    byId("drawings-none").hidden = drawings.list.length > 0;
    byId("map-canvas").parentElement.classList.toggle("has-drawings", drawings.list.length > 0);
    list.replaceChildren(...drawings.list.map((drawing) => item(drawings, drawing, look)));
    if (key) queryAll(key, HTMLButtonElement, list)[0]?.focus();
  });
  drawings.addEventListener("change", render);
  for (const button of queryAll("[data-draw]", HTMLButtonElement)) {
    button.addEventListener("click", () => draw(drawings, button.dataset.draw));
  }
  const file = /** @type {?HTMLInputElement} */ (document.getElementById("drawing-file"));
  file?.addEventListener("change", () => {
    take(drawings, file.files[0], look).catch((error) => toast(error.message, { kind: "error" }));
    file.value = "";
  });
  render();
}

function draw(drawings, kind) {
  drawings.draw(kind, (points) => drawingDialog({ kind, points }, {
    names: namesFor(drawings),
    save: (fields) => drawings.add({ kind, ...fields }),
  }));
}

/** Add the shapes of a file: one with a dialog, several at once. */
async function take(drawings, file, look) {
  if (!file) return;
  const shapes = await shapesOf(file);
  if (shapes.length === 1) {
    const [shape] = shapes;
    drawingDialog(shape, { names: namesFor(drawings), save: (fields) => drawings.add({ kind: shape.kind, ...fields }) });
    return;
  }
  let added = 0;
  try {
    for (const shape of shapes) {
      await drawings.add(shape);
      added += 1;
    }
  } finally {
    toast(t("{n} of {all} shapes were added.", { n: added, all: shapes.length }));
  }
  look(shapes.flatMap(({ points }) => points));
}

/** Names of tracks, and of those who are assigned already. */
function namesFor({ store, list }) {
  const tracks = store.mission.tracks.map(trackName);
  return [...new Set([...list.map(({ assigned }) => assigned), ...tracks])].filter(Boolean);
}

function item(drawings, drawing, look) {
  const { id, name, kind, searched } = drawing;
  const chosen = id === drawings.chosen;
  const show = () => {
    drawings.choose(chosen ? null : id);
    if (!chosen) look(drawing.points);
  };
  const swatch = h("span", { class: "mi-drawing__swatch", "aria-hidden": "true" });
  swatch.style.background = COLOURS[stateOf(drawing)];
  const share = drawings.coverage.get(id);
  return h("li", { class: chosen ? "mi-task is-chosen" : "mi-task", dataset: { id }, "data-testid": "drawing" },
    h("div", { class: "mi-task__head" },
      h("button", { class: "mi-object", type: "button", "aria-pressed": String(chosen), dataset: { does: "show" }, onclick: show }, swatch, name),
      kind === "area" && share && h("strong", { class: "number mi-drawing__share", "data-testid": "coverage" }, shareText(share)),
      kind === "area" && badge(drawing)),
    h("p", { class: "small soft" }, facts(drawing)),
    drawing.note && h("p", { class: "small" }, drawing.note),
    drawings.canEdit && h("div", { class: "mi-drawing__actions" },
      kind === "area" && action("search", searched ? t("Reopen") : t("Mark as searched"), { name, run: () => drawings.change(drawing, { searched: !searched }) }),
      sign("edit", "pencil", { label: t("Edit {name}", { name }), run: () => edit(drawings, drawing) }),
      sign("delete", "trash", { label: t("Delete {name}", { name }), run: () => remove(drawings, drawing) })));
}

function action(does, text, { name, run }) {
  return h("button", {
    class: "button", type: "button", dataset: { does }, "aria-label": t("{action}: {name}", { action: text, name }),
    onclick: (event) => busy(event.currentTarget, () => run().catch(toastError)),
  }, icon("check"), text);
}

function sign(does, picture, { label, run }) {
  return h("button", { class: "icon-button", type: "button", dataset: { does }, "aria-label": label, title: label, onclick: run }, icon(picture));
}

function badge(drawing) {
  const state = stateOf(drawing);
  const text = { open: t("To do"), assigned: t("Assigned"), searched: t("Searched") }[state];
  const look = { assigned: "badge badge--accent", searched: "badge badge--success" }[state] || "badge";
  return h("span", { class: look, "data-testid": "area-state" }, text);
}

/** Without all poses of the tracks, coverage is about right only. */
function shareText({ share, exact }) {
  if (share === null) return t("not measurable");
  return t("{share} covered", { share: exact ? percentText(share) : `≈ ${percentText(share)}` });
}

function facts(drawing) {
  const { kind, area_m2: size, length_m: length, radius_m: radius, assigned, created_by: author } = drawing;
  const by = drawing.searched_by
    ? t("searched by {name}, {time}", { name: drawing.searched_by, time: clockText(drawing.searched_time_s) })
    : drawing.searched ? clockText(drawing.searched_time_s) : "";
  return [
    kind === "area" ? areaText(size) : kind === "line" ? lengthText(length) : "",
    kind === "area" && t("radius {length}", { length: lengthText(radius) }),
    assigned,
    by,
    author && !by && t("drawn by {name}", { name: author }),
  ].filter(Boolean).join(" · ");
}

/** @param {number} size square metres */
function areaText(size) {
  if (size >= 100 * HECTARE_M2) return t("{n} km²", { n: numberText(size / 1e6, 2) });
  if (size >= HECTARE_M2) return t("{n} ha", { n: numberText(size / HECTARE_M2, 1) });
  return t("{n} m²", { n: numberText(size) });
}

function edit(drawings, drawing) {
  drawingDialog(drawing, {
    names: namesFor(drawings),
    save: (fields) => drawings.change(drawing, fields),
    redraw: () => drawings.draw(drawing.kind, (points) => drawings.change(drawing, { points }).catch(toastError)),
  });
}

async function remove(drawings, drawing) {
  const title = t("Delete {name}?", { name: drawing.name });
  if (await confirmDialog({ title, text: t("This cannot be undone."), action: t("Delete"), danger: true })) {
    await drawings.remove(drawing).catch(toastError);
  }
}
