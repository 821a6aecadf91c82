/** Drawing on the map: clicks or Enter add points, until the shape is done. */

import { h, icon } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";

/** A pointer that moves farther than this drags the map. */
const DRAG_PX = 6;
const touch = matchMedia("(pointer: coarse)");
const LEAST = { area: 3, line: 2, marker: 1 };

/**
 * Take clicks and keys while a shape is drawn; others get them at all other times.
 * @param {import("./drawing-store.js").DrawingStore} drawings
 * @param {import("../mission-view.js").MissionView} view
 */
export function connectSketch(drawings, view) {
  const bar = h("div", { class: "mi-sketch", role: "group", "aria-label": t("Draw"), "data-testid": "sketch-bar", hidden: true });
  view.element.parentElement.append(bar);
  const render = () => {
    const { sketch } = drawings;
    const begins = sketch && bar.hidden;
    bar.hidden = !sketch;
    view.element.parentElement.classList.toggle("is-drawing", Boolean(sketch));
    if (sketch) bar.replaceChildren(...content(drawings));
    if (begins) view.element.focus();
  };
  drawings.addEventListener("sketch", render);
  let down = null;
  const own = { capture: true };
  view.element.addEventListener("pointerdown", ({ clientX, clientY }) => (down = [clientX, clientY]), own);
  view.element.addEventListener("click", (event) => {
    if (!drawings.sketch || !view.map) return;
    const dragged = down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) > DRAG_PX;
    if (dragged || event.detail > 1) return; // the second of a double click zooms
    event.stopPropagation();
    addPoint(drawings, view, view.map.mouseEventToLatLng(event));
  }, own);
  view.element.addEventListener("keydown", (event) => {
    if (!drawings.sketch || !view.map || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Enter") addPoint(drawings, view, view.map.getCenter());
    else if (event.key === "Backspace") removeLast(drawings);
    else if (event.key === "Escape") drawings.stopSketch();
    else return;
    event.preventDefault();
    event.stopPropagation();
  }, own);
}

function addPoint(drawings, view, latLng) {
  const place = view.ground.latLonOf(latLng);
  if (!place) return;
  const points = [...drawings.sketch.points, place.map((value) => Math.round(value * 1e8) / 1e8)];
  drawings.setSketch(points);
  if (drawings.sketch.kind === "marker") finish(drawings);
}

function removeLast(drawings) {
  drawings.setSketch(drawings.sketch.points.slice(0, -1));
}

function finish(drawings) {
  const { points, done } = drawings.sketch;
  drawings.stopSketch();
  done(points);
}

function content(drawings) {
  const { kind, points } = drawings.sketch;
  const how = { area: t("Click the corners of the area"), line: t("Click the points of the line"), marker: t("Click the place") }[kind];
  const keys = t("Enter adds the middle of the map");
  const back = h("button", { class: "icon-button", type: "button", "aria-label": t("Remove the last point"), title: t("Remove the last point"), onclick: () => removeLast(drawings) }, icon("back"));
  const end = h("button", { class: "button button--primary", type: "button", disabled: points.length < LEAST[kind], onclick: () => finish(drawings) }, t("Done"));
  const cancel = h("button", { class: "button button--quiet", type: "button", onclick: () => drawings.stopSketch() }, t("Cancel"));
  return [
    h("span", { class: "small", role: "status" }, points.length ? t("Points: {n}", { n: points.length }) : touch.matches ? how : `${how}. ${keys}.`),
    points.length > 0 && back, kind !== "marker" && end, cancel,
  ].filter(Boolean);
}
