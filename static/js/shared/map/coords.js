/**
 * Conversions between map pixels, Leaflet positions, latitude and longitude; no other module converts them.
 *
 * Map pixels have x to the right and y down; (0, 0) is the outer corner of the top-left pixel. With
 * `L.CRS.Simple` one unit is one map pixel, `lng` is x and `lat` is -y. Angles are degrees clockwise.
 */

const EARTH_M = 6371008.8; // mean radius

/** Leaflet position of a map pixel. @param {number[]} pixel x, y */
export function latLngOf([x, y]) {
  return L.latLng(-y, x);
}

/** Map pixel of a Leaflet position. @param {L.LatLng} latLng @returns {[number, number]} */
export function pixelOf(latLng) {
  return [latLng.lng, -latLng.lat];
}

/** The whole image as Leaflet bounds. */
export function imageBounds(satellite) {
  return L.latLngBounds(latLngOf([0, satellite.height]), latLngOf([satellite.width, 0]));
}

/** Whether a map pixel is on the image. @param {number[]} pixel @param {{width: number, height: number}} satellite */
export function isInside([x, y], satellite) {
  return x >= 0 && y >= 0 && x <= satellite.width && y <= satellite.height;
}

/**
 * The nearest map pixel on the image, to a hundredth of a pixel.
 * @param {number[]} pixel
 * @param {{width: number, height: number}} satellite
 * @returns {[number, number]}
 */
export function clamped([x, y], satellite) {
  const limit = (value, most) => Math.round(Math.min(Math.max(value, 0), most) * 100) / 100;
  return [limit(x, satellite.width), limit(y, satellite.height)];
}

/** An angle in [0, 360), to a tenth of a degree. */
export function wholeTurn(degrees) {
  const turned = Math.round((((degrees % 360) + 360) % 360) * 10) / 10;
  return turned === 360 ? 0 : turned;
}

/** Direction from one map pixel to another, clockwise from image-up. @param {number[]} from @param {number[]} to */
export function imageAngle([x, y], [toX, toY]) {
  return (Math.atan2(toX - x, y - toY) * 180) / Math.PI;
}

/** Distance on the ground by the haversine formula, metres. @param {number[]} from lat, lon @param {number[]} to */
export function groundMetres(from, to) {
  const [[lat, lon], [toLat, toLon]] = [from, to].map((place) => place.map(radians));
  const half = Math.sin((toLat - lat) / 2) ** 2 + Math.cos(lat) * Math.cos(toLat) * Math.sin((toLon - lon) / 2) ** 2;
  return 2 * EARTH_M * Math.asin(Math.sqrt(half));
}

/** Direction on the ground, clockwise from north, in [0, 360). @param {number[]} from lat, lon @param {number[]} to */
export function bearingDeg(from, to) {
  const [[lat, lon], [toLat, toLon]] = [from, to].map((place) => place.map(radians));
  const east = Math.sin(toLon - lon) * Math.cos(toLat);
  const north = Math.cos(lat) * Math.sin(toLat) - Math.sin(lat) * Math.cos(toLat) * Math.cos(toLon - lon);
  return ((Math.atan2(east, north) * 180) / Math.PI + 360) % 360;
}

function radians(degrees) {
  return (degrees * Math.PI) / 180;
}

/** Latitude and longitude of map pixels, interpolated in the grid that the server samples. */
export class Georeference {
  /**
   * @param {?{metres_per_pixel: number, latlon_grid: {columns: number, rows: number, latlon: Array}}} state
   * @param {?{width: number, height: number}} satellite
   */
  constructor(state, satellite) {
    this.state = state;
    this.grid = satellite && state ? state.latlon_grid || null : null;
    this.metresPerPixel = (satellite && state && state.metres_per_pixel) || null;
    this.size = satellite ? [satellite.width, satellite.height] : [0, 0];
  }

  /**
   * Latitude and longitude of a map pixel on the image.
   * @param {number[]} pixel
   * @returns {?[number, number]} null if unknown
   */
  latLon([x, y]) {
    if (!this.grid) return null;
    const { columns, rows, latlon } = this.grid;
    const u = (x / this.size[0]) * columns;
    const v = (y / this.size[1]) * rows;
    const i = Math.min(Math.max(Math.floor(u), 0), columns - 1);
    const j = Math.min(Math.max(Math.floor(v), 0), rows - 1);
    const first = j * (columns + 1) + i;
    const corners = [latlon[first], latlon[first + 1], latlon[first + columns + 1], latlon[first + columns + 2]];
    if (corners.some((corner) => !corner)) return null;
    const [a, b] = [u - i, v - j];
    const weights = [(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b];
    const mean = (axis) => corners.reduce((sum, corner, n) => sum + corner[axis] * weights[n], 0);
    return [mean(0), ((mean(1) + 540) % 360) - 180];
  }

  /**
   * Distance of two map pixels on the ground, by the haversine formula.
   * @param {number[]} from
   * @param {number[]} to
   * @returns {?number} metres; null if a position is unknown
   */
  metres(from, to) {
    const places = [this.latLon(from), this.latLon(to)];
    return places.some((place) => !place) ? null : groundMetres(places[0], places[1]);
  }

  /** Where north points at a map pixel, clockwise from image-up; 0 without a georeference. @param {number[]} pixel */
  north([x, y]) {
    const step = Math.max(this.size[0], this.size[1]) / 100;
    const around = [[x - step, y], [x + step, y], [x, y - step], [x, y + step]].map((p) => this.latLon(p));
    if (around.some((p) => !p)) return 0;
    const shrink = Math.cos((around[0][0] * Math.PI) / 180);
    const difference = (p, q) => [(((q[1] - p[1] + 540) % 360) - 180) * shrink, q[0] - p[0]];
    const [right, down] = [difference(around[0], around[1]), difference(around[2], around[3])];
    const determinant = right[0] * down[1] - down[0] * right[1];
    return (Math.atan2(-down[0] / determinant, -right[0] / determinant) * 180) / Math.PI;
  }
}

/** A latitude and longitude as text. @param {number[]} place */
export function latLonText([lat, lon]) {
  const north = lat >= 0 ? "N" : "S";
  const east = lon >= 0 ? "E" : "W";
  return `${Math.abs(lat).toFixed(6)}° ${north}, ${Math.abs(lon).toFixed(6)}° ${east}`;
}

/** The largest 1, 2 or 5 times a power of ten that is not above a length. */
export function roundLength(length) {
  const power = 10 ** Math.floor(Math.log10(length));
  return [5, 2, 1].find((n) => n * power <= length) * power;
}

/** @typedef {{left: number, top: number, right: number, bottom: number}} Box */

/**
 * The part of an element that is on the screen, from its own corner; all of it, if it is not on the screen.
 * @param {Box} element edges in the window @param {number} screen height @returns {Box}
 */
export function onScreen({ left, top, right, bottom }, screen) {
  const [from, to] = [Math.max(top, 0) - top, Math.min(bottom, screen) - top];
  const part = to > from ? { top: from, bottom: to } : { top: 0, bottom: bottom - top };
  return { left: 0, right: right - left, ...part };
}

/**
 * How far to pan so that a point is in the middle of a box; along an axis on which it is inside, nothing.
 * @param {{x: number, y: number}} point @param {Box} box
 * @param {number} margin to the edges within which it counts as outside, at most a third of the box
 * @returns {[number, number]}
 */
export function panInto({ x, y }, { left, top, right, bottom }, margin) {
  const along = (at, from, to) => {
    const edge = Math.min(margin, (to - from) / 3);
    return at > from + edge && at < to - edge ? 0 : at - (from + to) / 2;
  };
  return [along(x, left, right), along(y, top, bottom)];
}
