/**
 * Draws on one canvas: all photos as plain dots, the hypotheses as numbered markers coloured by probability, their
 * radius and heading, the circle of a hint, and a position set by hand.
 */

import { CanvasLayer } from "../map/canvas-layer.js";
import { latLngOf } from "../map/coords.js";
import { colours, probabilityColours } from "./answer-format.js";
import { placesOf } from "./answer-places.js";
import { isFaint, isMinor } from "./verdict.js";

const DOT = 4;
const SMALL_ZOOM = 0.5;
const MARKER = 12;
const MINOR_MARKER = 9;
const WEDGE = 42;
const GUESSED_FOV = 60;
const NEAR = { mouse: 16, touch: 26 };

/** A Leaflet layer. */
export class AnswerLayer extends CanvasLayer {
  /**
   * @param {import("../map/map-store.js").MapStore} store
   * @param {import("./query-session.js").QuerySession} session
   */
  constructor(store, session) {
    super();
    this.store = store;
    this.session = session;
    this.draft = null;
    this._spots = [];
    store.on("photos placement satellite floor", this._draw);
    session.on("answer chosen hint spot", this._draw);
  }

  /** Show a circle while it is being drawn. @param {?Object} hint */
  setDraft(hint) {
    this.draft = hint;
    this._draw();
  }

  /** Ranks of the hypotheses under a point of the screen, the nearest first. */
  near(point, pointer = "mouse") {
    return this._spots
      .map((spot) => ({ ...spot, away: Math.hypot(spot.x - point.x, spot.y - point.y) }))
      .filter(({ away }) => away <= NEAR[pointer])
      .sort((a, b) => a.away - b.away)
      .flatMap(({ ranks }) => ranks);
  }

  /** @override */
  paint(pen) {
    this._pen = pen;
    this._zoom = this._map.getZoomScale(this._map.getZoom(), 0);
    if (this.store.satellite) this._all();
  }

  _all() {
    const { session } = this;
    this._hint(this.draft || session.hint);
    this._spots = placesOf(session.answer, this.store).filter(({ floor }) => this._isShown(floor)).map((spot) => ({ ...spot, ...this._at(spot.position) }));
    const chosen = this._spots.find(({ ranks }) => ranks.includes(session.chosen));
    const ordered = [...this._spots.filter((spot) => spot !== chosen), ...(chosen ? [chosen] : [])];
    for (const spot of ordered) this._reach(spot, spot === chosen);
    this._photos(chosen ? new Set(chosen.experiences) : new Set());
    for (const spot of ordered) this._marker(spot, spot === chosen && !session.spot);
    if (session.spot && this.store.placement === null) this._pin(this._at(session.spot));
  }

  /** Whether a place is on the floor that is shown. */
  _isShown(floor) {
    return !this.store.floors.length || floor === this.store.floor;
  }

  _at(position) {
    const { x, y } = this._map.latLngToContainerPoint(latLngOf(position));
    return { x, y };
  }

  /** Plain dots; those of photos that support the selected hypothesis are larger. */
  _photos(speaking) {
    const pen = this._pen;
    const dot = this._zoom < SMALL_ZOOM ? DOT - 1 : DOT;
    pen.lineWidth = 1.5;
    pen.fillStyle = "#fff";
    pen.strokeStyle = colours.ink;
    pen.beginPath(); // one path: 20 000 paths of one dot each would take 0.2 s
    const drawn = new Set();
    const size = this._map.getSize();
    for (const id of this.store.order) {
      const position = this.store.isOnFloor(id) && this.store.position(id);
      if (!position) continue;
      const { x, y } = this._at(position);
      if (x < -dot || y < -dot || x > size.x + dot || y > size.y + dot) continue;
      const radius = speaking.has(id) ? dot + 2 : dot;
      const key = (Math.round(x) * 2 ** 16 + Math.round(y)) * 8 + radius;
      if (drawn.has(key)) continue;
      drawn.add(key);
      pen.moveTo(x + radius, y);
      pen.arc(x, y, radius, 0, 2 * Math.PI);
    }
    pen.fill();
    pen.stroke();
  }

  /** The 68 % radius and the heading of the camera. */
  _reach({ x, y, radius, heading, position, probability }, chosen) {
    if (!chosen && isMinor(this.session.answer, probability)) return;
    const pen = this._pen;
    const faint = isFaint(this.session.answer, probability);
    const { fill } = probabilityColours(probability);
    if (radius) {
      pen.beginPath();
      pen.arc(x, y, Math.max(radius * this._zoom, MARKER), 0, 2 * Math.PI);
      pen.globalAlpha = chosen ? 0.28 : 0.16;
      pen.fillStyle = fill;
      if (!faint) pen.fill();
      pen.globalAlpha = chosen ? 1 : faint ? 0.4 : 0.6;
      this._stroke(fill, chosen ? 2 : 1.25);
      pen.globalAlpha = 1;
    }
    if (heading === null || (!chosen && probability < 0.1)) return;
    const middle = this.angleOf(heading + this.store.georeference.north(position));
    const half = (((this.session.answer.fov_deg || GUESSED_FOV) / 2) * Math.PI) / 180;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.arc(x, y, WEDGE, middle - half, middle + half);
    pen.closePath();
    pen.globalAlpha = chosen ? 0.6 : 0.35;
    pen.fillStyle = fill;
    pen.fill();
    pen.globalAlpha = 1;
  }

  _marker({ x, y, probability, ranks }, chosen) {
    const pen = this._pen;
    const { fill, text } = probabilityColours(probability);
    const { answer } = this.session;
    const plain = isMinor(answer, probability) ? MINOR_MARKER : MARKER;
    const radius = chosen ? MARKER + 3 : plain;
    const faint = isFaint(answer, probability);
    const rims = faint
      ? [[radius + 1.5, colours.ink], [radius, "#fff"]]
      : [[radius + 3, colours.ink], [radius + 1.5, "#fff"], [radius - 0.5, fill]];
    for (const [rim, colour] of rims) {
      pen.beginPath();
      pen.arc(x, y, rim, 0, 2 * Math.PI);
      pen.fillStyle = colour;
      pen.fill();
    }
    pen.fillStyle = faint ? colours.ink : text;
    pen.font = `${faint ? 500 : 700} ${chosen ? 15 : plain + 1}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(String(ranks[0]), x, y + 0.5);
  }

  _hint(hint) {
    if (!hint || this.store.placement !== null) return;
    const pen = this._pen;
    const { x, y } = this._at([hint.x_px, hint.y_px]);
    pen.beginPath();
    pen.arc(x, y, hint.radius_px * this._zoom, 0, 2 * Math.PI);
    pen.setLineDash([7, 5]);
    this._stroke("#fff", 2);
    pen.setLineDash([]);
  }

  /** The position set by hand, the only red mark. */
  _pin({ x, y }) {
    const pen = this._pen;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.bezierCurveTo(x - 3, y - 9, x - 11, y - 14, x - 11, y - 23);
    pen.arc(x, y - 23, 11, Math.PI, 0);
    pen.bezierCurveTo(x + 11, y - 14, x + 3, y - 9, x, y);
    pen.fillStyle = colours.truth;
    pen.fill();
    this._stroke("#fff", 2);
    pen.beginPath();
    pen.arc(x, y - 23, 4, 0, 2 * Math.PI);
    pen.fillStyle = "#fff";
    pen.fill();
  }

  /** A line with a dark edge, visible on any background. */
  _stroke(colour, width) {
    const pen = this._pen;
    pen.lineWidth = width + 2;
    pen.strokeStyle = "rgb(0 0 0 / 0.45)";
    pen.stroke();
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.stroke();
  }
}
