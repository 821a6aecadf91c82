/** Coloured cells show how well the parts of a map are recognised; numbers with wedges show the spots of a plan. */

import { CanvasLayer } from "./canvas-layer.js";
import { latLngOf } from "./coords.js";

/** From poorly to well recognised: orange to blue, a palette safe for colour blindness. */
export const CLASSES = ["#b3430a", "#ef8a3c", "#f7dfae", "#8fc0de", "#1f5f9e"];
const UNSURE = 0.2;
const OPACITY = { sure: 0.72, unsure: 0.4 };
const RADIUS = 12;
const WEDGE = 34;
const HALF_WEDGE = Math.PI / 7;

/** A Leaflet layer. */
export class PlanLayer extends CanvasLayer {
  /** @param {import("./map-store.js").MapStore} store */
  constructor(store) {
    super();
    this.store = store;
    this.plan = null;
    this.cells = true;
    this.current = null;
    this.done = new Set();
  }

  /** @param {?Object} plan as returned by the API @param {{cells?: boolean, current?: ?number, done?: Set<number>}} [look] */
  show(plan, { cells = this.cells, current = this.current, done = this.done } = {}) {
    Object.assign(this, { plan, cells, current, done });
    this._draw();
  }

  /** @override */
  paint(pen) {
    if (!this.plan) return;
    if (this.cells) this._cells(pen);
    const style = getComputedStyle(this._canvas);
    const ink = (name) => style.getPropertyValue(`--map-${name}`).trim();
    const spots = this.plan.spots.map((spot) => ({ spot, at: this._map.latLngToContainerPoint(latLngOf([spot.x_px, spot.y_px])) }));
    for (const { spot, at } of spots) if (!this.done.has(spot.number)) this._wedges(pen, spot, { at, colour: ink("current-wedge"), rim: ink("rim") });
    for (const { spot, at } of spots) this._number(pen, spot, at);
  }

  _cells(pen) {
    const { cells, cell_px: side } = this.plan;
    const scale = this._map.getZoomScale(this._map.getZoom(), 0);
    const origin = this._map.latLngToContainerPoint(latLngOf([0, 0]));
    const edge = (value) => Math.round(value * scale);
    pen.save();
    pen.translate(origin.x, origin.y);
    pen.rotate((this.turn.degrees * Math.PI) / 180);
    cells.recognised.forEach((share, n) => {
      const [left, top] = [cells.x_px[n] - side / 2, cells.y_px[n] - side / 2];
      const [x, y] = [edge(left), edge(top)];
      pen.globalAlpha = cells.sigma[n] > UNSURE ? OPACITY.unsure : OPACITY.sure;
      pen.fillStyle = CLASSES[Math.min(Math.floor(share * CLASSES.length), CLASSES.length - 1)];
      pen.fillRect(x, y, edge(left + side) - x, edge(top + side) - y);
    });
    pen.restore();
  }

  _wedges(pen, { x_px, y_px, headings_deg: headings }, { at, colour, rim }) {
    const north = this.store.georeference.north([x_px, y_px]);
    pen.lineWidth = 1.5;
    for (const heading of headings) {
      const middle = this.angleOf(heading + north);
      pen.beginPath();
      pen.moveTo(at.x, at.y);
      pen.arc(at.x, at.y, WEDGE, middle - HALF_WEDGE, middle + HALF_WEDGE);
      pen.closePath();
      pen.fillStyle = colour;
      pen.fill();
      pen.strokeStyle = rim;
      pen.stroke();
    }
  }

  /** A dark number on yellow, or a tick on grey when done; the current spot has an additional ring. */
  _number(pen, { number }, { x, y }) {
    const done = this.done.has(number);
    if (number === this.current) this._disc(pen, { x, y, radius: RADIUS + 5, fill: "#ff6a00" });
    this._disc(pen, { x, y, radius: RADIUS, fill: done ? "#e4e7e5" : "#ffd400" });
    pen.fillStyle = "#1b2321";
    pen.font = "700 13px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(done ? "✓" : String(number), x, y + 0.5);
  }

  _disc(pen, { x, y, radius, fill }) {
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.fillStyle = fill;
    pen.fill();
    pen.lineWidth = 2;
    pen.strokeStyle = "#1b2321";
    pen.stroke();
  }
}
