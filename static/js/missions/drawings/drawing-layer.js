/** Canvases with the search areas, lines and markers, and the shape being drawn; their texts are above the tracks. */

import { CanvasLayer } from "../../shared/map/canvas-layer.js";
import { lengthText, percentText } from "../format.js";
import { COLOURS, stateOf } from "./drawing-store.js";

const RIM = "#ffffff";
const INK = "#14181a";
/** Areas narrower than this on the screen have no text. */
const LABEL_PX = 34;
const CROSS = 14;

/** A Leaflet layer whose canvas is in the page only while something is drawn. */
class DrawnLayer extends CanvasLayer {
  /**
   * @param {import("./drawing-store.js").DrawingStore} drawings
   * @param {import("../mission-view.js").MissionView} view
   */
  constructor(drawings, view) {
    super();
    this.drawings = drawings;
    this.view = view;
    for (const name of ["change", "sketch"]) drawings.addEventListener(name, () => this._show());
  }

  /** @override @param {L.Map} map */
  onAdd(map) {
    super.onAdd(map);
    this._show();
    return this;
  }

  _show() {
    if (!this._canvas || !this._map) return;
    if (!this.drawings.list.length && !this.drawings.sketch) this._canvas.remove();
    else if (!this._canvas.isConnected) this._place(this._map.getPane("overlayPane"));
    this._draw();
  }

  /** @param {HTMLElement} pane */
  _place(pane) {
    pane.append(this._canvas);
  }
}

/** The shapes, below the tracks. */
export class DrawingLayer extends DrawnLayer {
  /** @param {import("./drawing-store.js").DrawingStore} drawings @param {import("../mission-view.js").MissionView} view */
  constructor(drawings, view) {
    super(drawings, view);
    for (const name of ["focus", "blur"]) view.element.addEventListener(name, this._draw);
  }

  /** @override @param {HTMLElement} pane */
  _place(pane) {
    pane.insertBefore(this._canvas, pane.querySelector("canvas"));
  }

  /** @override */
  paint(pen, size) {
    pen.lineJoin = pen.lineCap = "round";
    for (const drawing of this.drawings.list) {
      const places = placesOf(this.view, drawing.points);
      if (!places) continue;
      const chosen = drawing.id === this.drawings.chosen;
      drawShape(pen, places, { kind: drawing.kind, colour: COLOURS[stateOf(drawing)], chosen });
    }
    const { sketch } = this.drawings;
    if (!sketch) return;
    const places = placesOf(this.view, sketch.points) || [];
    if (places.length > 1) drawShape(pen, places, { kind: sketch.kind, colour: COLOURS.line, chosen: true });
    for (const place of places) drawDot(pen, place, COLOURS.line);
    if (this.view.element.matches(":focus-visible")) drawCross(pen, size.x / 2, size.y / 2);
  }
}

/** The names of the drawings, with percent or length. */
export class LabelLayer extends DrawnLayer {
  /** @override */
  paint(pen) {
    pen.lineJoin = "round";
    for (const drawing of this.drawings.list) {
      const places = placesOf(this.view, drawing.points);
      if (places) drawLabel(pen, this._text(drawing), drawing.kind, places);
    }
  }

  /** @returns {[string, string]} */
  _text({ id, kind, name, length_m: length }) {
    const share = this.drawings.coverage.get(id)?.share;
    if (kind === "area") return [name, share === null || share === undefined ? "" : percentText(share)];
    return [name, kind === "line" ? lengthText(length) : ""];
  }
}

/** Points on the screen; null if one is not on the background. */
function placesOf({ ground, map }, points) {
  const flats = points.map(([lat, lon]) => ground.flat(lat, lon));
  return flats.every(Boolean) ? flats.map((flat) => map.latLngToContainerPoint(ground.latLngOf(flat))) : null;
}

function drawShape(pen, places, { kind, colour, chosen }) {
  if (kind === "marker") {
    drawDot(pen, places[0], colour, chosen ? 9 : 7);
    return;
  }
  pen.beginPath();
  for (const { x, y } of places) pen.lineTo(x, y);
  if (kind === "area") {
    pen.closePath();
    pen.globalAlpha = chosen ? 0.38 : 0.24;
    pen.fillStyle = colour;
    pen.fill();
    pen.globalAlpha = 1;
  }
  for (const [width, ink] of [[chosen ? 7 : 5, RIM], [chosen ? 4 : 2.5, colour]]) {
    pen.lineWidth = width;
    pen.strokeStyle = ink;
    pen.stroke();
  }
}

function drawDot(pen, { x, y }, colour, radius = 6) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  for (const [width, ink] of [[5, RIM], [2, INK]]) {
    pen.lineWidth = width;
    pen.strokeStyle = ink;
    pen.stroke();
  }
  pen.fillStyle = colour;
  pen.fill();
}

/** The name, and below it percent or length: in the middle of an area, beside anything else. */
function drawLabel(pen, [name, number], kind, places) {
  const [xs, ys] = [places.map(({ x }) => x), places.map(({ y }) => y)];
  const [width, height] = [Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys)];
  if (kind === "area" && Math.min(width, height) < LABEL_PX) return;
  const middle = places[Math.floor(places.length / 2)];
  const [x, y] = kind === "area" ? [Math.min(...xs) + width / 2, Math.min(...ys) + height / 2] : [middle.x + 12, middle.y];
  pen.textAlign = kind === "area" ? "center" : "start";
  pen.textBaseline = "middle";
  const lines = [[name, 13], [number, 15]].filter(([text]) => text);
  lines.forEach(([text, size], n) => {
    pen.font = `600 ${size}px system-ui, sans-serif`;
    const line = y + (n - (lines.length - 1) / 2) * 17;
    pen.lineWidth = 4;
    pen.strokeStyle = RIM;
    pen.strokeText(text, x, line);
    pen.fillStyle = INK;
    pen.fillText(text, x, line);
  });
}

/** The middle of the map, where Enter adds a point. */
function drawCross(pen, x, y) {
  pen.beginPath();
  pen.moveTo(x - CROSS, y);
  pen.lineTo(x + CROSS, y);
  pen.moveTo(x, y - CROSS);
  pen.lineTo(x, y + CROSS);
  for (const [width, ink] of [[5, RIM], [2, INK]]) {
    pen.lineWidth = width;
    pen.strokeStyle = ink;
    pen.stroke();
  }
}
