/**
 * The tiles of a map service below the image of a map: web Mercator, transformed to map pixels.
 *
 * The tiles of one zoom level are laid edge to edge, and the level as a whole gets the affine transformation that fits
 * the georeference in the view: no seams appear, and the middle of the view is exact.
 */

import { latLngOf, pixelOf } from "./coords.js";
import { addressOf } from "./tile-address.js";
import { turnOf } from "./turned-crs.js";

const TILE = 256;
const LARGEST_LAT = 85.05;
/** Most tiles that are requested for a view. */
const MOST_TILES = 400;

/** A failed tile is requested again when the view moves, but not sooner than this. */
const AGAIN_MS = 10_000;

/** A position in the grid of web Mercator: the world is the unit square, x to the east and y to the south. @param {[number, number]} place lat, lon */
export function mercator([lat, lon]) {
  const sine = Math.sin((Math.min(Math.max(lat, -LARGEST_LAT), LARGEST_LAT) * Math.PI) / 180);
  return [lon / 360 + 0.5, 0.5 - Math.atanh(sine) / (2 * Math.PI)];
}

/** An affine function of the plane: a linear part and the image of the origin. */
export class Affine {
  /** @param {number[]} linear xx, xy, yx, yy: the coefficients of x and y in the first and the second coordinate @param {number[]} origin */
  constructor([xx, xy, yx, yy], origin) {
    this.xx = xx;
    this.xy = xy;
    this.yx = yx;
    this.yy = yy;
    this.origin = origin;
  }

  /** @param {number[]} point @returns {[number, number]} */
  apply([x, y]) {
    return [this.xx * x + this.xy * y + this.origin[0], this.yx * x + this.yy * y + this.origin[1]];
  }

  get determinant() {
    return this.xx * this.yy - this.xy * this.yx;
  }

  inverse() {
    const { xx, xy, yx, yy, origin, determinant } = this;
    const linear = new Affine([yy, -xy, -yx, xx].map((value) => value / determinant), [0, 0]);
    const [x, y] = linear.apply(origin);
    return new Affine([linear.xx, linear.xy, linear.yx, linear.yy], [-x, -y]);
  }
}

/**
 * The affine function from web Mercator to map pixels around a map pixel.
 * @param {import("./coords.js").Georeference} georeference
 * @param {number[]} middle map pixel
 * @param {number} reach pixels to each side
 * @returns {?Affine} null if the georeference gives no positions
 */
export function pixelsFromMercator(georeference, [x, y], reach) {
  const places = [[x, y], [x - reach, y], [x + reach, y], [x, y - reach], [x, y + reach]].map((pixel) => georeference.latLon(pixel));
  if (places.some((place) => !place)) return null;
  const [centre, left, right, above, below] = places.map(mercator);
  const slope = (from, to) => [turned(to[0] - from[0]), to[1] - from[1]].map((change) => change / (2 * reach));
  const [[xx, yx], [xy, yy]] = [slope(left, right), slope(above, below)];
  const toMercator = new Affine([xx, xy, yx, yy], [0, 0]);
  if (!(Math.abs(toMercator.determinant) > 0)) return null;
  const [dx, dy] = toMercator.apply([x, y]);
  toMercator.origin = [centre[0] - dx, centre[1] - dy];
  return toMercator.inverse();
}

/** A difference in units of the world's width, across the antimeridian if that is shorter. */
function turned(x) {
  return x - Math.round(x);
}

/**
 * The tiles that a view shows: those that overlap both the view and its bounding box in the grid.
 * @param {function(number[]): number[]} toView from the grid, in tiles, to pixels of the view
 * @param {number[][]} corners of the view, in tiles
 * @param {{x: number, y: number}} size of the view
 * @returns {[number, number][]} columns and rows, the nearest to the middle first
 */
export function tilesInView(toView, corners, size) {
  const [xs, ys] = [0, 1].map((axis) => corners.map((corner) => corner[axis]));
  const [west, east, north, south] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)].map(Math.floor);
  if ((east - west + 1) * (south - north + 1) > 8 * MOST_TILES) return []; // too many; 8: the bounding box of a rotated view is larger
  const found = [];
  for (let column = west; column <= east; column += 1) {
    for (let row = north; row <= south; row += 1) {
      const quad = [[column, row], [column + 1, row], [column + 1, row + 1], [column, row + 1]].map(toView);
      const [us, vs] = [0, 1].map((axis) => quad.map((corner) => corner[axis]));
      const meets = Math.min(...us) < size.x && Math.max(...us) > 0 && Math.min(...vs) < size.y && Math.max(...vs) > 0;
      if (meets) found.push({ tile: [column, row], far: Math.hypot(us[0] + us[2] - size.x, vs[0] + vs[2] - size.y) });
    }
  }
  return found.sort((a, b) => a.far - b.far).map(({ tile }) => /** @type {[number, number]} */ (tile));
}

/** The Leaflet layer. */
export class TileBackground extends L.Layer {
  /**
   * @param {{url: string, attribution: string, maxZoom: number}} service
   * @param {import("./coords.js").Georeference} georeference
   * @param {function({shown: number, failed: number}): void} arrived called when all tiles of a view have loaded or failed
   */
  constructor(service, georeference, arrived) {
    super();
    this.arrived = arrived;
    this.service = service;
    this.georeference = georeference;
    this.levels = [];
  }

  /** @override @param {L.Map} map */
  onAdd(map) {
    this._map = map;
    this._box = L.DomUtil.create("div", "leaflet-layer map-background", map.getPane("tilePane"));
    this._online = () => {
      for (const level of this.levels) level.forgetFailed(0);
      this._update();
    };
    addEventListener("online", this._online);
    this._update();
    return this;
  }

  /** @override */
  onRemove() {
    removeEventListener("online", this._online);
    for (const level of this.levels) level.drop();
    this.levels = [];
    this._box.remove();
    return this;
  }

  /** @override */
  getEvents() {
    const ahead = (/** @type {*} */ { zoom, center }) => this._place((at) => /** @type {*} */ (this._map)._latLngToNewLayerPoint(at, zoom, center), zoom);
    return {
      viewreset: () => this._place(),
      zoom: () => this._place(),
      zoomanim: ahead,
      moveend: () => this._update(),
      resize: () => this._update(),
    };
  }

  /** Position the levels on the screen. */
  _place(layerPoint = (at) => this._map.latLngToLayerPoint(at), zoom = this._map.getZoom()) {
    const scale = this._map.getZoomScale(zoom, 0);
    for (const level of this.levels) level.place(layerPoint, scale, turnOf(this._map));
  }

  /** Request the tiles of the view. */
  _update() {
    const map = this._map;
    const size = map.getSize();
    const scale = map.getZoomScale(map.getZoom(), 0);
    const toPixels = size.x && pixelsFromMercator(this.georeference, pixelOf(map.getCenter()), Math.min(size.x, size.y) / 2 / scale);
    if (!toPixels) return this._keep(null);
    const sharp = Math.log2((Math.sqrt(Math.abs(toPixels.determinant)) * scale) / TILE);
    const zoom = Math.min(Math.max(Math.round(sharp), 0), this.service.maxZoom);
    const level = this.levels.find((one) => one.zoom === zoom) ?? new Level(zoom, this.service, () => this._arrived(level));
    level.lay(toPixels, pixelOf(map.getCenter()));
    this._keep(level);
    this._place();
    const toView = (tile) => {
      const { x, y } = map.latLngToContainerPoint(latLngOf(level.pixelOf(tile)));
      return [x, y];
    };
    const view = [[0, 0], [size.x, 0], [size.x, size.y], [0, size.y]].map(([x, y]) => level.tileOf(pixelOf(map.containerPointToLatLng([x, y]))));
    level.show(tilesInView(toView, view, size));
  }

  /** Show a level on top; earlier levels stay below it until its tiles have loaded. */
  _keep(level) {
    if (level && !this.levels.includes(level)) {
      this.levels.push(level);
      this._box.append(level.element);
    }
    for (const one of this.levels) {
      one.element.style.zIndex = one === level ? "1" : "0";
      if (one !== level) one.stop();
    }
    if (!level) this._only(null);
  }

  _only(level) {
    for (const one of this.levels) if (one !== level) one.drop();
    this.levels = this.levels.filter((one) => one === level);
  }

  _arrived(level) {
    if (level.element.style.zIndex !== "1") return; // another zoom level is shown by now
    const counts = level.counts();
    if (counts.shown) this._only(level);
    this.arrived(counts);
  }
}

/** The tiles of one zoom level. */
class Level {
  /** @param {number} zoom @param {{url: string}} service @param {function(): void} arrived called when no tile is loading */
  constructor(zoom, service, arrived) {
    this.zoom = zoom;
    this.service = service;
    this.arrived = arrived;
    this.across = 2 ** zoom;
    /** @type {Map<string, {image: HTMLImageElement, state: string, at: number}>} */
    this.tiles = new Map();
    this.element = L.DomUtil.create("div", "map-background__level leaflet-zoom-animated");
    this.first = null;
  }

  /** Set the affine function of the view. @param {Affine} toPixels from web Mercator @param {number[]} middle map pixel */
  lay(toPixels, middle) {
    this.toPixels = toPixels;
    this.fromPixels = toPixels.inverse();
    this.first ??= this.tileOf(middle).map(Math.floor); // origin of positions in the level, so that they stay small
  }

  /** Map pixel of a position in the grid. @param {number[]} tile */
  pixelOf([column, row]) {
    return this.toPixels.apply([column / this.across, row / this.across]);
  }

  /** Position of a map pixel in the grid, in tiles. @param {number[]} pixel */
  tileOf(pixel) {
    return this.fromPixels.apply(pixel).map((value) => value * this.across);
  }

  place(layerPoint, scale, turn) {
    const { x, y } = layerPoint(latLngOf(this.pixelOf(this.first)));
    const unit = scale / this.across / TILE;
    const { xx, xy, yx, yy } = this.toPixels;
    const [[a, b], [c, d]] = [turn.forth([xx, yx]), turn.forth([xy, yy])].map((column) => column.map((value) => value * unit));
    this.element.style.transform = `matrix(${[a, b, c, d, x, y].join(", ")})`;
  }

  /** Show exactly these tiles. @param {[number, number][]} wanted */
  show(wanted) {
    const shown = wanted.slice(0, MOST_TILES).filter(([, row]) => row >= 0 && row < this.across);
    const keys = new Set(shown.map(String));
    this.forgetFailed(AGAIN_MS);
    for (const [key, { image }] of this.tiles) if (!keys.has(key)) this._forget(key, image);
    for (const tile of shown) if (!this.tiles.has(String(tile))) this._load(tile);
    this._check();
  }

  _load([column, row]) {
    const image = new Image();
    const tile = { image, state: "loading", at: 0 };
    const done = (state) => {
      tile.state = state;
      tile.at = performance.now();
      image.hidden = state === "failed";
      this._check();
    };
    this.tiles.set(String([column, row]), tile);
    image.alt = "";
    image.onload = () => done("shown");
    image.onerror = () => done("failed");
    image.referrerPolicy = "strict-origin-when-cross-origin"; // tile services require the referring site
    image.style.left = `${(column - this.first[0]) * TILE}px`;
    image.style.top = `${(row - this.first[1]) * TILE}px`;
    const east = ((column % this.across) + this.across) % this.across;
    image.src = addressOf(this.service.url, { z: this.zoom, x: east, y: row });
    this.element.append(image);
  }

  /** Forget failed tiles, so that they are requested again. @param {number} age minimum milliseconds since they failed */
  forgetFailed(age) {
    const before = performance.now() - age;
    for (const [key, { image, state, at }] of this.tiles) if (state === "failed" && at <= before) this._forget(key, image);
  }

  /** Cancel loading; tiles that have loaded stay. */
  stop() {
    for (const [key, { image, state }] of this.tiles) if (state === "loading") this._forget(key, image);
  }

  _forget(key, image) {
    image.onload = image.onerror = null;
    image.removeAttribute("src"); // cancels the download
    image.remove();
    this.tiles.delete(key);
  }

  _check() {
    if (![...this.tiles.values()].some(({ state }) => state === "loading")) this.arrived();
  }

  counts() {
    const states = [...this.tiles.values()].map(({ state }) => state);
    return { shown: states.filter((state) => state === "shown").length, failed: states.filter((state) => state === "failed").length };
  }

  drop() {
    for (const [key, { image }] of this.tiles) this._forget(key, image);
    this.element.remove();
  }
}
