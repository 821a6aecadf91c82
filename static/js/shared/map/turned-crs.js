/**
 * An image that is drawn turned: Leaflet's positions stay pixels of the image, and the projection turns them. So the
 * map itself is never turned on the screen, and everything that goes through Leaflet (marks, clicks, moves) follows.
 */

import { latLngOf, pixelOf } from "./coords.js";

/** A turn of the plane about the origin, clockwise on the screen; the plane has x to the right and y down. */
export class Turn {
  /** @param {number} degrees */
  constructor(degrees) {
    this.degrees = degrees;
    this.cos = Math.cos((degrees * Math.PI) / 180);
    this.sin = Math.sin((degrees * Math.PI) / 180);
  }

  /** From the image to how it is drawn. @param {number[]} point @returns {[number, number]} */
  forth([x, y]) {
    return [x * this.cos - y * this.sin, x * this.sin + y * this.cos];
  }

  /** From how the image is drawn to the image. @param {number[]} point @returns {[number, number]} */
  back([x, y]) {
    return [x * this.cos + y * this.sin, y * this.cos - x * this.sin];
  }

  /**
   * The upright rectangle around a turned one.
   * @param {number[]} corner left, top
   * @param {number[]} opposite right, bottom
   * @param {"forth"|"back"} [way]
   * @returns {[number, number, number, number]} left, top, right, bottom
   */
  around([left, top], [right, bottom], way = "forth") {
    const corners = [[left, top], [right, top], [right, bottom], [left, bottom]].map((corner) => this[way](corner));
    const [xs, ys] = [0, 1].map((axis) => corners.map((corner) => corner[axis]));
    return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
  }
}

export const UPRIGHT = new Turn(0);

/** Leaflet's `CRS.Simple` with a turn, which may be changed: `crs.turn`. The map is to be drawn anew then. */
export function turnableCrs() {
  const crs = {
    ...L.CRS.Simple,
    turn: UPRIGHT,
    projection: {
      ...L.Projection.LonLat,
      project: (latLng) => {
        const [x, y] = crs.turn.forth(pixelOf(latLng));
        return L.point(x, -y);
      },
      unproject: ({ x, y }) => latLngOf(crs.turn.back([x, -y])),
    },
  };
  return crs;
}

/** How a map draws its image turned. @param {L.Map} map @returns {Turn} */
export function turnOf(map) {
  return /** @type {*} */ (map.options.crs).turn ?? UPRIGHT;
}
