/** A canvas over the whole map, redrawn at every move; during a zoom animation it is scaled with the map. */

import { rafThrottle } from "../timing.js";
import { turnOf } from "./turned-crs.js";

const EVENTS = "move zoom viewreset resize zoomend moveend";

/** A Leaflet layer; `this._draw()` schedules a call of `paint` in the next frame. */
export class CanvasLayer extends L.Layer {
  constructor() {
    super();
    this._draw = rafThrottle(() => this._map && this._paint());
  }

  /**
   * Draw everything on the cleared canvas.
   * @param {CanvasRenderingContext2D} pen in CSS pixels of the container
   * @param {L.Point} size
   */
  // eslint-disable-next-line no-unused-vars -- the parameters are for subclasses
  paint(pen, size) {
    throw new Error("a layer paints itself");
  }

  /** The rotation of the map. */
  get turn() {
    return turnOf(this._map);
  }

  /** Angle of a direction on the canvas, radians clockwise from the right. @param {number} degrees clockwise from image-up */
  angleOf(degrees) {
    return ((degrees + this.turn.degrees - 90) * Math.PI) / 180;
  }

  /** @override @param {L.Map} map */
  onAdd(map) {
    this._canvas = L.DomUtil.create("canvas", "ed-dots leaflet-zoom-animated");
    map.getPane("overlayPane").append(this._canvas);
    map.on(EVENTS, this._draw, this);
    map.on("zoomanim", this._animate, this);
    this._draw();
    return this;
  }

  /** @override @param {L.Map} map */
  onRemove(map) {
    this._canvas.remove();
    map.off(EVENTS, this._draw, this);
    map.off("zoomanim", this._animate, this);
    return this;
  }

  _animate(event) {
    const scale = this._map.getZoomScale(event.zoom);
    const offset = /** @type {*} */ (this._map)._latLngToNewLayerPoint(this._northWest, event.zoom, event.center);
    L.DomUtil.setTransform(this._canvas, offset, scale);
  }

  _paint() {
    const [map, canvas] = [this._map, this._canvas];
    const size = map.getSize();
    const ratio = devicePixelRatio || 1;
    const [width, height] = [Math.round(size.x * ratio), Math.round(size.y * ratio)];
    if (canvas.width !== width || canvas.height !== height) {
      Object.assign(canvas, { width, height });
      Object.assign(canvas.style, { width: `${size.x}px`, height: `${size.y}px` });
    }
    this._northWest = map.containerPointToLatLng([0, 0]);
    L.DomUtil.setTransform(canvas, map.containerPointToLayerPoint([0, 0]), 1);
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, size.x, size.y);
    this.paint(pen, size);
  }
}
