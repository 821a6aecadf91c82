/** Everything that is drawn on the ground, on one canvas, anew at every move. */

import { eachFrame } from "../editor/page.js";
import { drawGrid } from "./drawgrid.js";
import { drawTracks } from "./drawtracks.js";
import { drawObjects } from "./drawobjects.js";
import { drawMarks } from "./drawmarks.js";
import { Inks } from "./inks.js";

const EVENTS = "move zoom viewreset resize zoomend moveend";
const NEAR = { mouse: 14, touch: 24 };
const INKS = ["rim", "grid", "grid-strong", "text", "halo", "robot", "current"].map((name) => `--mi-${name}`);

/** A layer of Leaflet. */
export const Scene = L.Layer.extend({
  /**
   * @param {import("./store.js").Store} store
   * @param {import("./lines.js").Lines} lines
   * @param {import("./view.js").MissionView} view
   */
  initialize(store, lines, view) {
    Object.assign(this, { store, lines, view, hover: null, _spots: [] });
    this._draw = eachFrame(() => this._map && this._paint());
    store.on("missions shown mode moment objects fixes matching chosen trail grown", this._draw);
    lines.addEventListener("change", this._draw);
    this._inks = new Inks(view.element, INKS, this._draw);
    view.addEventListener("ground", () => this._inks.forget());
  },

  onAdd(map) {
    this._canvas = L.DomUtil.create("canvas", "ed-dots leaflet-zoom-animated");
    map.getPane("overlayPane").append(this._canvas);
    map.on(EVENTS, this._draw, this);
    map.on("zoomanim", this._animate, this);
    this._draw();
  },

  onRemove(map) {
    this._canvas.remove();
    map.off(EVENTS, this._draw, this);
    map.off("zoomanim", this._animate, this);
  },

  /** Point at a moment of the time line. @param {?number} moment */
  setHover(moment) {
    this.hover = moment;
    this._draw();
  },

  /** Keys of the objects and fixes under a point of the screen, the nearest first. */
  near(point, pointer = "mouse") {
    return this._spots
      .map((spot) => ({ ...spot, away: Math.hypot(spot.x - point.x, spot.y - point.y) }))
      .filter(({ away }) => away <= NEAR[pointer])
      .sort((a, b) => a.away - b.away);
  },

  _animate(event) {
    const scale = this._map.getZoomScale(event.zoom);
    const offset = this._map._latLngToNewLayerPoint(this._northWest, event.zoom, event.center);
    L.DomUtil.setTransform(this._canvas, offset, scale);
  },

  _paint() {
    const [map, canvas] = [this._map, this._canvas];
    const size = map.getSize();
    const ratio = devicePixelRatio || 1;
    const [width, height] = [Math.round(size.x * ratio), Math.round(size.y * ratio)];
    if (canvas.width !== width || canvas.height !== height) {
      Object.assign(canvas, { width, height });
      Object.assign(canvas.style, { width: `${size.x}px`, height: `${size.y}px` });
    }
    this._northWest = map.containerPointToLatLng([0, 0]);
    L.DomUtil.setTransform(canvas, map.containerPointToLayerPoint([0, 0]), 1);
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, size.x, size.y);
    const frame = this._frame(size);
    if (frame.ground.name === "plain") drawGrid(pen, frame);
    drawTracks(pen, frame, this);
    this._spots = drawObjects(pen, frame, this.store);
    drawMarks(pen, frame, this);
  },

  /** How flat coordinates come to the screen, and the colours of the style sheet. */
  _frame(size) {
    const { ground } = this.view;
    const scale = this._map.getZoomScale(this._map.getZoom(), 0);
    const corner = this._map.project(this._northWest, 0);
    return {
      ground, size, scale, ink: this._inks.all, metresPerPixel: this.view.metresPerPixel,
      x: (flat) => (flat - corner.x) * scale,
      y: (flat) => (flat - corner.y) * scale,
      place(lat, lon) {
        const flat = ground.flat(lat, lon);
        return flat ? { x: this.x(flat[0]), y: this.y(flat[1]) } : null;
      },
      turn: (x, y) => ground.north(ground.latLngOf([x, y])),
    };
  },
});
