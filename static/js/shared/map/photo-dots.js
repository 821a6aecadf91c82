/**
 * All photos of the image on one canvas: dots, headings, the selection, the GPS circle of the current photo.
 * Redrawn at every move. If thousands are in view, neighbouring photos share a dot until one zooms in.
 */

import { h } from "../dom.js";
import { CanvasLayer } from "./canvas-layer.js";
import { latLngOf } from "./coords.js";

const RADIUS = 6;
const WEDGE = 26;
const HANDLE = 46;
const GUESSED_FOV = 60;
/** With more photos in view, they are merged in cells of `CELL` screen pixels and drawn without headings. */
const CROWD = 2000;
const CELL = 14;
const MOST_NAMED = 99;
/** Minimum radius of a circle of spread dots, and their spacing on it; screen pixels. */
const FAN = 34;
const FAN_STEP = 30;
const NEAR = { mouse: 10, touch: 22 };

/** A Leaflet layer that shows the state of `store`. */
export class PhotoDots extends CanvasLayer {
  constructor(store) {
    super();
    this.store = store;
    this.colours = null;
    this.mark = null;
    this.suggestions = [];
    this._spots = [];
    this._stamps = new Map();
    /** @type {Map<number, {x: number, y: number}>} offsets of spread dots, screen pixels */
    this._fan = new Map();
    store.on("photos preview look current selection placement satellite floor", this._draw);
  }

  /** @override @param {L.Map} map */
  onAdd(map) {
    map.on("zoomstart", this._close, this);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", this._draw);
    return super.onAdd(map);
  }

  /** Whether dots are spread. */
  get isFanned() {
    return this._fan.size > 0;
  }

  /**
   * Spread photos in a circle around their position until the next zoom; an empty list ends it.
   * @param {number[]} ids
   */
  fan(ids) {
    const radius = Math.max(FAN, (ids.length * FAN_STEP) / (2 * Math.PI));
    const turn = (n) => (2 * Math.PI * n) / ids.length - Math.PI / 2;
    this._fan = new Map(ids.map((id, n) => [id, { x: radius * Math.cos(turn(n)), y: radius * Math.sin(turn(n)) }]));
    this._spots = this._place(this._map.getSize()); // for a click before the next frame
    this._draw();
  }

  _close() {
    if (this.isFanned) this.fan([]);
  }

  /** Set colours of photos. @param {?Map<number, string>} colours by id */
  setColours(colours) {
    this.colours = colours;
    this._draw();
  }

  /** Mark some map pixels with rings. @param {number[][]} pixels */
  setMark(pixels) {
    this.mark = pixels;
    this._draw();
  }

  /**
   * Show where photos would be placed, as hollow dots.
   * @param {Array<{x_px: number, y_px: number, radius_px: number, heading_deg: ?number}>} suggestions
   */
  setSuggestions(suggestions) {
    this.suggestions = suggestions;
    this._draw();
  }

  /**
   * Photos under a point of the screen: the current and the selected ones first, then by distance.
   * @param {L.Point} point in the container
   * @param {"mouse"|"touch"} pointer
   * @returns {number[]} ids
   */
  near(point, pointer = "mouse") {
    const { selection, currentId } = this.store;
    const first = (id) => (id === currentId ? 0 : selection.has(id) ? 1 : 2);
    return this._spots
      .map(({ x, y, ids }) => ({ away: Math.hypot(x - point.x, y - point.y), ids }))
      .filter(({ away }) => away <= NEAR[pointer])
      .sort((a, b) => a.away - b.away)
      .flatMap(({ ids }) => ids)
      .sort((a, b) => first(a) - first(b));
  }

  /** Whether a point of the screen is on the rotation handle of the current photo. */
  onHandle(point, pointer = "mouse") {
    const at = this._handle;
    return Boolean(at) && Math.hypot(at.x - point.x, at.y - point.y) <= NEAR[pointer];
  }

  /** Ids in a rectangle of the screen. */
  within(bounds) {
    return this._spots.filter(({ x, y }) => bounds.contains([x, y])).flatMap(({ ids }) => ids);
  }

  /** @override */
  paint(pen, size) {
    this._pen = pen;
    this._ink = inks(this._canvas);
    this._handle = null;
    this._spots = this._place(size);
    if (this.store.satellite) this._all();
  }

  /** Screen positions of the photos; those at one position, or in one cell of a crowd, share a spot. */
  _place(size) {
    const { store } = this;
    this._origin = this._map.latLngToContainerPoint(latLngOf([0, 0]));
    this._scale = this._map.getZoomScale(this._map.getZoom(), 0);
    const seen = [];
    for (const id of store.order) {
      const spot = store.isOnFloor(id) ? this._spotOf(id) : null;
      if (spot && spot.x > -WEDGE && spot.y > -WEDGE && spot.x < size.x + WEDGE && spot.y < size.y + WEDGE) seen.push(spot);
    }
    this._crowded = seen.length > CROWD;
    const step = this._crowded ? CELL / this._scale : 0.5;
    const spots = new Map();
    for (const spot of seen) {
      const away = this._fan.get(spot.ids[0]);
      if (away) {
        spots.set(`fan ${spot.ids[0]}`, { ...spot, x: spot.x + away.x, y: spot.y + away.y, foot: { x: spot.x, y: spot.y } });
        continue;
      }
      const [column, row] = spot.position.map((value) => Math.round(value / step));
      const key = column * 2 ** 26 + row;
      const known = spots.get(key);
      if (known) known.ids.push(...spot.ids);
      else spots.set(key, spot);
    }
    return [...spots.values()];
  }

  /** Screen position of one photo; null for a photo in the tray. */
  _spotOf(id) {
    const position = this.store.position(id);
    if (!position) return null;
    const [x, y] = this.turn.forth(position);
    return { x: this._origin.x + x * this._scale, y: this._origin.y + y * this._scale, ids: [id], position };
  }

  _all() {
    const { currentId, selection } = this.store;
    this._gpsCircle();
    this._radiusCircle();
    for (const { foot, x, y } of this._spots) if (foot) this._leg(foot, { x, y });
    if (!this._crowded) for (const spot of this._spots) for (const id of spot.ids) this._wedge(spot, id);
    for (const spot of this._spots) {
      const chosen = spot.ids.some((id) => selection.has(id));
      this._dot(spot, this._colour(spot.ids[0], chosen), chosen);
    }
    const current = this._spots.some(({ ids }) => ids.includes(currentId)) && this._spotOf(currentId);
    if (current) this._current(current, currentId);
    for (const suggestion of this.suggestions) this._suggestion(suggestion);
    for (const pixel of this.mark || []) this._ring(this._map.latLngToContainerPoint(latLngOf(pixel)), 16, this._ink.mark);
  }

  /** Line from the true position of a spread dot to where it is drawn. */
  _leg(from, to) {
    const pen = this._pen;
    for (const [width, ink] of [[4, this._ink.rim], [1.5, this._ink.dot]]) {
      pen.beginPath();
      pen.moveTo(from.x, from.y);
      pen.lineTo(to.x, to.y);
      pen.lineWidth = width;
      pen.strokeStyle = ink;
      pen.stroke();
    }
  }

  _colour(id, chosen) {
    if (chosen) return this._ink.selected;
    return this.colours ? this.colours.get(id) || this._ink.faint : this._ink.dot;
  }

  _wedge(spot, id) {
    const heading = this.store.heading(id);
    if (heading === null) return;
    this._sector(spot, id, { heading, fov: this.store.photos.get(id)?.fov_deg || GUESSED_FOV });
  }

  _sector(spot, id, { heading, fov }) {
    const middle = this._angle(spot, heading);
    const half = ((fov / 2) * Math.PI) / 180;
    const pen = this._pen;
    pen.beginPath();
    pen.moveTo(spot.x, spot.y);
    pen.arc(spot.x, spot.y, WEDGE, middle - half, middle + half);
    pen.closePath();
    pen.fillStyle = id === this.store.currentId ? this._ink.currentWedge : this._ink.wedge;
    pen.fill();
  }

  /** Canvas angle (clockwise from the right) of a heading. */
  _angle(spot, heading) {
    return this.angleOf(heading + this.store.georeference.north(spot.position));
  }

  _dot({ x, y, ids }, colour, chosen) {
    const label = ids.length > MOST_NAMED ? `${MOST_NAMED}+` : ids.length > 1 ? String(ids.length) : "";
    const stamp = this._stamp(label, colour, chosen);
    const side = stamp.width / (devicePixelRatio || 1);
    this._pen.drawImage(stamp, x - side / 2, y - side / 2, side, side);
  }

  /** The cached picture of a dot: thousands are drawn at each move. */
  _stamp(label, colour, chosen) {
    const ratio = devicePixelRatio || 1;
    const key = [label, colour, chosen, this._ink.rim, ratio].join();
    const known = this._stamps.get(key);
    if (known) return known;
    const radius = label ? RADIUS + 2 : RADIUS;
    const stamp = h("canvas", { width: Math.ceil(2 * (radius + 3) * ratio), height: Math.ceil(2 * (radius + 3) * ratio) });
    const pen = stamp.getContext("2d");
    pen.scale(ratio, ratio);
    const middle = stamp.width / ratio / 2;
    pen.beginPath();
    pen.arc(middle, middle, radius, 0, 2 * Math.PI);
    pen.fillStyle = colour;
    pen.fill();
    pen.lineWidth = chosen ? 3 : 2;
    pen.strokeStyle = this._ink.rim;
    pen.stroke();
    pen.fillStyle = this._ink.rim;
    pen.font = "600 10px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(label, middle, middle + 0.5);
    this._stamps.set(key, stamp);
    return stamp;
  }

  _current(spot, id) {
    this._wedge(spot, id);
    const { look } = this.store;
    const middle = this.store.heading(id);
    if (look?.id === id && middle !== null) this._sector(spot, id, { heading: middle + look.turn, fov: look.fov });
    this._ring(spot, RADIUS + 7, this._ink.current);
    this._dot({ ...spot, ids: [id] }, this._ink.current, true);
    if (!this.store.canEdit) return;
    const heading = this.store.heading(id);
    const angle = this._angle(spot, heading ?? 0);
    const [dx, dy] = [Math.cos(angle), Math.sin(angle)];
    this._handle = { x: spot.x + dx * HANDLE, y: spot.y + dy * HANDLE };
    this._arrow(spot, [dx, dy], heading === null);
  }

  _arrow({ x, y }, [dx, dy], unknown) {
    const pen = this._pen;
    pen.beginPath();
    pen.setLineDash(unknown ? [3, 4] : []);
    pen.moveTo(x + dx * (RADIUS + 8), y + dy * (RADIUS + 8));
    pen.lineTo(x + dx * (HANDLE - 8), y + dy * (HANDLE - 8));
    pen.lineWidth = 5;
    pen.strokeStyle = this._ink.rim;
    pen.stroke();
    pen.lineWidth = 2.5;
    pen.strokeStyle = this._ink.current;
    pen.stroke();
    pen.setLineDash([]);
    pen.beginPath();
    pen.arc(x + dx * HANDLE, y + dy * HANDLE, 8, 0, 2 * Math.PI);
    pen.fillStyle = this._ink.rim;
    pen.fill();
    pen.stroke();
    pen.beginPath();
    const tip = [x + dx * (HANDLE + 4), y + dy * (HANDLE + 4)];
    pen.moveTo(...tip);
    pen.lineTo(x + dx * (HANDLE - 3) - dy * 4, y + dy * (HANDLE - 3) + dx * 4);
    pen.lineTo(x + dx * (HANDLE - 3) + dy * 4, y + dy * (HANDLE - 3) - dx * 4);
    pen.closePath();
    pen.fillStyle = this._ink.current;
    pen.fill();
  }

  _ring({ x, y }, radius, colour) {
    const pen = this._pen;
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.lineWidth = 4.5;
    pen.strokeStyle = this._ink.rim;
    pen.stroke();
    pen.lineWidth = 2.5;
    pen.strokeStyle = colour;
    pen.stroke();
  }

  /** A hollow dot with its circle of uncertainty and its heading. */
  _suggestion({ x_px, y_px, radius_px: radius, heading_deg: heading }) {
    const position = [x_px, y_px];
    const { x, y } = this._map.latLngToContainerPoint(latLngOf(position));
    const pen = this._pen;
    pen.beginPath();
    pen.arc(x, y, Math.max(radius * this._scale, RADIUS), 0, 2 * Math.PI);
    pen.lineWidth = 1;
    pen.strokeStyle = this._ink.mark;
    pen.stroke();
    if (heading !== null) {
      const angle = this._angle({ position }, heading);
      pen.beginPath();
      pen.moveTo(x + RADIUS * Math.cos(angle), y + RADIUS * Math.sin(angle));
      pen.lineTo(x + WEDGE * Math.cos(angle), y + WEDGE * Math.sin(angle));
      pen.lineWidth = 2.5;
      pen.stroke();
    }
    this._ring({ x, y }, RADIUS, this._ink.mark);
  }

  /** Circle of uncertainty of the current photo, if its position was suggested. */
  _radiusCircle() {
    const { currentId } = this.store;
    const radius = currentId === null ? null : this.store.radius(currentId);
    if (radius === null || !this.store.isOnFloor(currentId)) return;
    const { x, y } = this._map.latLngToContainerPoint(latLngOf(this.store.position(currentId)));
    this._pen.beginPath();
    this._pen.arc(x, y, Math.max(radius * this._scale, RADIUS), 0, 2 * Math.PI);
    this._pen.lineWidth = 1;
    this._pen.strokeStyle = this._ink.mark;
    this._pen.stroke();
  }

  /** Circle of uncertainty of the current photo's GPS position. */
  _gpsCircle() {
    const gps = this.store.current?.gps;
    if (!gps || gps.x_px === null || gps.x_px === undefined) return;
    const { x, y } = this._map.latLngToContainerPoint(latLngOf([gps.x_px, gps.y_px]));
    const pen = this._pen;
    const radius = Math.max((gps.radius_px || 0) * this._map.getZoomScale(this._map.getZoom(), 0), 4);
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    pen.fillStyle = this._ink.gpsFill;
    pen.fill();
    pen.lineWidth = 1.5;
    pen.setLineDash([5, 4]);
    pen.strokeStyle = this._ink.gps;
    pen.stroke();
    pen.setLineDash([]);
    pen.beginPath();
    pen.arc(x, y, 3, 0, 2 * Math.PI);
    pen.fillStyle = this._ink.gps;
    pen.fill();
  }
}

/**
 * Colours of the style sheet, so that the canvas follows light, dark and contrast settings.
 * @param {HTMLCanvasElement} canvas
 * @returns {Object<string, string>}
 */
function inks(canvas) {
  const style = getComputedStyle(canvas);
  const ink = (name) => style.getPropertyValue(`--map-${name}`).trim();
  const names = ["dot", "rim", "wedge", "selected", "faint", "current", "mark", "gps"];
  const found = Object.fromEntries(names.map((name) => [name, ink(name)]));
  return { ...found, currentWedge: ink("current-wedge"), gpsFill: ink("gps-fill") };
}
