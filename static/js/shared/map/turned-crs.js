/**
 * An image drawn rotated: Leaflet's positions remain pixels of the image, and the projection rotates them. So the map
 * element itself is not rotated, and everything that goes through Leaflet (markers, clicks, moves) follows.
 */

import { latLngOf, pixelOf } from "./coords.js";

/** A rotation of the plane about the origin, clockwise on the screen; x to the right, y down. */
export class Turn {
  /** @param {number} degrees */
  constructor(degrees) {
    this.degrees = degrees;
    this.cos = Math.cos((degrees * Math.PI) / 180);
    this.sin = Math.sin((degrees * Math.PI) / 180);
  }

  /** From the image to the rotated image. @param {number[]} point @returns {[number, number]} */
  forth([x, y]) {
    return [x * this.cos - y * this.sin, x * this.sin + y * this.cos];
  }

  /** From the rotated image to the image. @param {number[]} point @returns {[number, number]} */
  back([x, y]) {
    return [x * this.cos + y * this.sin, y * this.cos - x * this.sin];
  }

  /**
   * The bounding box of a rotated rectangle.
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

/** Leaflet's `CRS.Simple` with a rotation `crs.turn`; after changing it, redraw the map. */
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

/** The rotation of a map. @param {L.Map} map @returns {Turn} */
export function turnOf(map) {
  return /** @type {*} */ (map.options.crs).turn ?? UPRIGHT;
}
