/** Canvas with everything over the ground, redrawn at every move. */

import { CanvasLayer } from "../shared/map/canvas-layer.js";
import { ThemeColours } from "../shared/theme-colours.js";
import { drawGrid } from "./draw-grid.js";
import { drawMarks } from "./draw-marks.js";
import { drawObjects } from "./draw-objects.js";
import { drawTracks } from "./draw-tracks.js";

const NEAR = { mouse: 14, touch: 24 };
const INKS = ["rim", "grid", "grid-strong", "text", "halo", "robot", "current"].map((name) => `--mi-${name}`);

/** A Leaflet layer. */
export class Scene extends CanvasLayer {
  /**
   * @param {import("./mission-store.js").MissionStore} store
   * @param {import("./track-lines.js").TrackLines} lines
   * @param {import("./mission-view.js").MissionView} view
   */
  constructor(store, lines, view) {
    super();
    this.store = store;
    this.lines = lines;
    this.view = view;
    this.hover = null;
    this._spots = [];
    store.on("missions shown mode moment objects fixes matching chosen trail grown", this._draw);
    lines.addEventListener("change", this._draw);
    this._inks = new ThemeColours(view.element, INKS, this._draw);
    view.addEventListener("ground", () => this._inks.forget());
  }

  /** Mark a moment of the timeline on the map. @param {?number} moment */
  setHover(moment) {
    this.hover = moment;
    this._draw();
  }

  /** Keys of the objects and fixes under a point of the screen, the nearest first. */
  near(point, pointer = "mouse") {
    return this._spots
      .map((spot) => ({ ...spot, away: Math.hypot(spot.x - point.x, spot.y - point.y) }))
      .filter(({ away }) => away <= NEAR[pointer])
      .sort((a, b) => a.away - b.away);
  }

  /** @override */
  paint(pen, size) {
    const frame = this._frame(size);
    if (frame.ground.name === "plain") drawGrid(pen, frame);
    drawTracks(pen, frame, this);
    this._spots = drawObjects(pen, frame, this.store);
    drawMarks(pen, frame, this);
  }

  /** Conversion of flat coordinates to the screen, and colours of the style sheet. */
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
  }
}
