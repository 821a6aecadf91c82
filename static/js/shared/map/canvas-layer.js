/** A canvas over all of a map, drawn anew at every move; while a zoom is animated it is scaled with the map. */

import { rafThrottle } from "../timing.js";

const EVENTS = "move zoom viewreset resize zoomend moveend";

/** A layer of Leaflet; who extends it calls `begin` in `initialize`, and has `paint(pen, size)`. */
export const CanvasLayer = L.Layer.extend({
  /** Make ready what `this._draw` asks for: a new picture with the next frame. */
  begin() {
    this._spots = [];
    this._draw = rafThrottle(() => this._map && this._paint());
  },

  onAdd(map) {
    this._canvas = L.DomUtil.create("canvas", "ed-dots leaflet-zoom-animated");
    map.getPane("overlayPane").append(this._canvas);
    map.on(EVENTS, this._draw, this);
    map.on("zoomanim", this._animate, this);
    this._draw();
  },

  onRemove(map) {
    this._canvas.remove();
    map.off(EVENTS, this._draw, this);
    map.off("zoomanim", this._animate, this);
  },

  _animate(event) {
    const scale = this._map.getZoomScale(event.zoom);
    const offset = this._map._latLngToNewLayerPoint(this._northWest, event.zoom, event.center);
    L.DomUtil.setTransform(this._canvas, offset, scale);
  },

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
  },
});
