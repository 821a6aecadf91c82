/** Position and heading of a robot at its start, and conversion of tracks from its frame. */

import { t } from "../../shared/i18n.js";
import { PlainGround } from "../background.js";

const RADIANS = Math.PI / 180;

/**
 * @typedef {{lat: number, lon: number, heading_deg: number}} Start
 */

/** The start being chosen, possibly incomplete; fires `change`. */
export class StartPose extends EventTarget {
  constructor() {
    super();
    /** @type {Array<?number>} latitude, longitude, heading */
    this._values = [null, null, null];
  }

  /** Latitude, longitude, heading; null: unknown. */
  get values() {
    return [...this._values];
  }

  /** @returns {?[number, number]} latitude, longitude */
  get position() {
    const [lat, lon] = this._values;
    return lat === null || lon === null ? null : [lat, lon];
  }

  get heading() {
    return this._values[2];
  }

  /** @returns {?Start} null while incomplete or invalid */
  get whole() {
    const [lat, lon, heading] = this._values;
    return this.problem || lat === null ? null : { lat, lon, heading_deg: heading };
  }

  get isEmpty() {
    return this._values.every((value) => value === null);
  }

  /** Message on what is missing or wrong; empty for a complete start, and for none. */
  get problem() {
    const [lat, lon, heading] = this._values;
    if (this.isEmpty) return "";
    if (!this.position) return t("The start needs a latitude and a longitude.");
    if (!(Math.abs(lat) <= 90 && Math.abs(lon) <= 180)) return t("The start is not on the Earth: latitudes go to 90, longitudes to 180 degrees.");
    if (heading === null) return t("The start also needs a heading: the direction the robot was facing.");
    return Math.abs(heading) <= 360 ? "" : t("The heading is between 0 and 360 degrees.");
  }

  /** @param {Array<?number>} values latitude, longitude, heading; null: unknown */
  set(values) {
    if (values.every((value, n) => value === this._values[n])) return;
    this._values = [...values];
    this.dispatchEvent(new Event("change"));
  }

  /** @param {[number, number]} position */
  moveTo([lat, lon]) {
    this.set([lat, lon, this.heading]);
  }

  /** @param {number} degrees clockwise from north */
  turnTo(degrees) {
    const [lat, lon] = this._values;
    this.set([lat, lon, degrees]);
  }
}

/**
 * Convert a track to latitude and longitude, approximately, for a preview; the server computes it exactly.
 * @param {Array<[number, number]>} line metres forward and left of the start
 * @param {Start} start
 * @returns {Array<[number, number]>} latitudes and longitudes
 */
export function laid(line, { lat, lon, heading_deg: heading }) {
  const plane = new PlainGround([lat, lon]);
  const [sin, cos] = [Math.sin(heading * RADIANS), Math.cos(heading * RADIANS)];
  const place = (east, north) => plane.latLonOf(plane.latLngOf([east, -north]));
  return line.map(([ahead, left]) => place(ahead * sin - left * cos, ahead * cos + left * sin));
}

/**
 * The direction from one position to another nearby.
 * @param {[number, number]} from latitude, longitude
 * @param {[number, number]} to
 * @returns {number} degrees clockwise from north, to a tenth, in [0, 360)
 */
export function headingTo(from, [lat, lon]) {
  const [east, south] = new PlainGround(from).flat(lat, lon);
  const degrees = Math.round((Math.atan2(east, -south) / RADIANS) * 10) / 10;
  return degrees < 0 ? degrees + 360 : degrees + 0;
}

/** The position ahead of a start. @param {Start} start @param {number} metres @returns {[number, number]} */
export function placeAhead(start, metres) {
  return laid([[metres, 0]], start)[0];
}
