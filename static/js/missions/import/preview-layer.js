/** Draws tracks on the ground of a preview, in the colours of their sources, with start and end. */

import { CanvasLayer } from "../../shared/map/canvas-layer.js";
import { ThemeColours } from "../../shared/theme-colours.js";
import { sourceColour } from "../colour-scales.js";
import { drawGrid } from "../draw-grid.js";

const LINE = 3.5;
const RIM = 6.5;
const FAINT = 0.45;
const END = 5;
const INKS = ["rim", "grid", "grid-strong", "text", "halo"].map((name) => `--mi-${name}`);

/** A Leaflet layer. */
export class PreviewLayer extends CanvasLayer {
  /** @param {import("../mission-view.js").MissionView} view */
  constructor(view) {
    super();
    this.view = view;
    this._lines = [];
    this._arrow = null;
    this._inks = new ThemeColours(view.element, INKS, this._draw);
    view.addEventListener("ground", () => this._inks.forget());
  }

  /** @param {Array<{source: ?string, latlon: Array<[number, number]>}>} lines without a source: tracks already in the mission */
  setLines(lines) {
    const { ground } = this.view;
    this._lines = lines.map(({ source, latlon }) => ({ source, flat: latlon.map(([lat, lon]) => ground.flat(lat, lon)).filter(Boolean) }));
    this._draw();
  }

  /** @param {?[L.LatLng, L.LatLng]} ends of the arrow at the start */
  setArrow(ends) {
    this._arrow = ends;
    this._draw();
  }

  /** @override */
  paint(pen, size) {
    const ink = this._inks.all;
    const scale = this._map.getZoomScale(this._map.getZoom(), 0);
    const corner = this._map.project(this._northWest, 0);
    const [x, y] = [(flat) => (flat - corner.x) * scale, (flat) => (flat - corner.y) * scale];
    if (this.view.ground.name === "plain") drawGrid(pen, { size, scale, ink, x, y });
    pen.lineJoin = pen.lineCap = "round";
    for (const { source, flat } of this._lines) {
      const points = flat.map(([u, v]) => [x(u), y(v)]);
      if (source === null) drawKnown(pen, points, ink);
      else drawTrack(pen, points, { colour: sourceColour(source), ink });
    }
    if (this._arrow) drawArrow(pen, this._arrow.map((end) => this._map.latLngToContainerPoint(end)), ink);
  }
}

function path(pen, points) {
  pen.beginPath();
  points.forEach(([x, y], n) => (n ? pen.lineTo(x, y) : pen.moveTo(x, y)));
}

function drawKnown(pen, points, ink) {
  path(pen, points);
  pen.globalAlpha = FAINT;
  pen.lineWidth = 2;
  pen.strokeStyle = ink.text;
  pen.stroke();
  pen.globalAlpha = 1;
}

function drawTrack(pen, points, { colour, ink }) {
  if (!points.length) return;
  path(pen, points);
  for (const [width, style] of [[RIM, ink.rim], [LINE, colour]]) {
    pen.lineWidth = width;
    pen.strokeStyle = style;
    pen.stroke();
  }
  drawEnd(pen, points[0], { fill: ink.halo, rim: colour });
  drawEnd(pen, points.at(-1), { fill: colour, rim: ink.rim });
}

function drawEnd(pen, [x, y], { fill, rim }) {
  pen.beginPath();
  pen.arc(x, y, END, 0, 2 * Math.PI);
  pen.fillStyle = fill;
  pen.fill();
  pen.lineWidth = 2;
  pen.strokeStyle = rim;
  pen.stroke();
}

/** @param {CanvasRenderingContext2D} pen @param {L.Point[]} ends @param {Object} ink */
function drawArrow(pen, [from, to], ink) {
  for (const [width, style] of [[6, ink.halo], [3, ink.text]]) {
    path(pen, [[from.x, from.y], [to.x, to.y]]);
    pen.lineWidth = width;
    pen.strokeStyle = style;
    pen.stroke();
  }
}
