/** A Leaflet map whose image may be rotated: where Leaflet uses two corners of a rectangle, all four are needed. */

import { latLngOf, pixelOf } from "./coords.js";
import { Turn, turnableCrs, turnOf, UPRIGHT } from "./turned-crs.js";

/** Bounds are always in pixels of the unrotated image. */
export class TurnedMap extends L.Map {
  /** @param {HTMLElement} element @param {L.MapOptions} options */
  constructor(element, options) {
    super(element, { ...options, crs: turnableCrs() });
  }

  /** Rotate the map around the middle of the view. @param {number} degrees clockwise */
  turnTo(degrees) {
    const middle = this.getCenter();
    /** @type {*} */ (this.options.crs).turn = degrees ? new Turn(degrees) : UPRIGHT;
    this.setView(middle, this.getZoom(), /** @type {*} */ ({ animate: false, reset: true }));
  }

  /** Bounds around the view; with rotation they contain more than the view. @override */
  getBounds() {
    const { min, max } = this.getPixelBounds();
    const corners = [[min.x, min.y], [max.x, min.y], [max.x, max.y], [min.x, max.y]];
    return L.latLngBounds(corners.map(([x, y]) => this.unproject(L.point(x, y))));
  }

  /** @override */
  getBoundsZoom(bounds, inside, padding) {
    return this._asUpright(L.latLngBounds(bounds), (box) => super.getBoundsZoom(box, inside, padding));
  }

  /** How far a view exceeds its limits; overrides a method of Leaflet. */
  _getBoundsOffset(view, limit, zoom) {
    return this._asUpright(limit, (box) => /** @type {*} */ (L.Map.prototype)._getBoundsOffset.call(this, view, box, zoom));
  }

  /** Call a method of Leaflet with the bounding box of rotated bounds, as if nothing were rotated. */
  _asUpright(bounds, ask) {
    const turn = turnOf(this);
    const [left, top, right, bottom] = turn.around(pixelOf(bounds.getNorthWest()), pixelOf(bounds.getSouthEast()));
    const crs = /** @type {*} */ (this.options.crs);
    crs.turn = UPRIGHT;
    try {
      return ask(L.latLngBounds(latLngOf([left, bottom]), latLngOf([right, top])));
    } finally {
      crs.turn = turn;
    }
  }
}
