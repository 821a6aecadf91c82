/** The image of a map, as one picture or in tiles, on a map that may be rotated. */

import { imageBounds } from "./coords.js";
import { turnOf, UPRIGHT } from "./turned-crs.js";

const TILE = 256;

/** Like `L.DomUtil.setTransform`, with rotation. @param {HTMLElement} element @param {L.Point} at */
function place(element, { x, y }, scale, turn) {
  element.style.transformOrigin = "0 0"; // Leaflet's style sheet sets it only for animated elements
  element.style.transform = `translate3d(${x}px, ${y}px, 0) rotate(${turn.degrees}deg) scale(${scale})`;
}

/** A picture between bounds. Methods with an underscore override private ones of Leaflet. */
class TurnedImage extends L.ImageOverlay {
  /** As in Leaflet, with rotation. */
  _reset() {
    const { _map: map, _image: image, _bounds: bounds } = /** @type {*} */ (this);
    const scale = map.getZoomScale(map.getZoom(), 0);
    const at = map.latLngToLayerPoint(bounds.getNorthWest());
    image.style.width = `${(bounds.getEast() - bounds.getWest()) * scale}px`;
    image.style.height = `${(bounds.getNorth() - bounds.getSouth()) * scale}px`;
    place(image, at, 1, turnOf(map));
  }

  /** As in Leaflet, with rotation. */
  _animateZoom(event) {
    const { _map: map, _image: image, _bounds: bounds } = /** @type {*} */ (this);
    const at = map._latLngToNewLayerPoint(bounds.getNorthWest(), event.zoom, event.center);
    place(image, at, map.getZoomScale(event.zoom), turnOf(map));
  }
}

/** Tiles of an image: their grid is that of the image, and each level is rotated as a whole. */
class TurnedTiles extends L.TileLayer {
  /** @override @param {L.Map} map */
  onAdd(map) {
    this.on("tileloadstart", this._place, this);
    return super.onAdd(map);
  }

  /** Position tiles without transforms of their own, which would show seams: the level is rotated as a whole. */
  _place({ tile, coords }) {
    if (turnOf(this._map) === UPRIGHT) return;
    const { x, y } = this._getTilePos(coords);
    Object.assign(tile.style, { transform: "none", left: `${x}px`, top: `${y}px`, willChange: "auto" });
  }

  /** Set the transform of a level. */
  _setZoomTransform(level, centre, zoom) {
    const map = /** @type {*} */ (this._map);
    const turn = turnOf(map);
    // origin of the level's tiles, in whole pixels of the tiles so that they are drawn sharply
    level.corner ??= L.point(turn.back([level.origin.x, level.origin.y])).round();
    const scale = map.getZoomScale(zoom, level.zoom);
    const at = L.point(turn.forth([level.corner.x, level.corner.y])).multiplyBy(scale).subtract(map._getNewPixelOrigin(centre, zoom));
    place(level.el, at.round(), scale, turn);
  }

  /** Position of a tile in its level. */
  _getTilePos(coords) {
    return coords.scaleBy(this.getTileSize()).subtract(/** @type {*} */ (this)._levels[coords.z].corner);
  }

  /** The part of the grid that is in view. */
  _getTiledPixelBounds(centre) {
    const { min, max } = /** @type {*} */ (L.TileLayer.prototype)._getTiledPixelBounds.call(this, centre);
    const [left, top, right, bottom] = turnOf(this._map).around([min.x, min.y], [max.x, max.y], "back");
    return L.bounds([left, top], [right, bottom]);
  }

  /** The corners of a tile on the image. */
  _tileCoordsToNwSe(coords) {
    const corner = coords.scaleBy(this.getTileSize());
    return [corner, corner.add(this.getTileSize())].map((point) => L.CRS.Simple.pointToLatLng(point, coords.z));
  }
}

/** A picture that covers the whole image. @param {string} url @param {{width: number, height: number}} satellite @param {L.ImageOverlayOptions} [options] */
export function pictureLayer(url, satellite, options = {}) {
  return new TurnedImage(url, imageBounds(satellite), { alt: "", ...options });
}

/** The image of a map, in tiles if it has any. @param {{url: string, width: number, height: number, tiles: ?Object}} satellite */
export function satelliteLayer(satellite) {
  if (!satellite.tiles) return pictureLayer(satellite.url, satellite);
  const most = satellite.tiles.max_zoom;
  return new TurnedTiles(satellite.tiles.url, {
    tileSize: TILE,
    zoomOffset: most,
    minNativeZoom: -most,
    maxNativeZoom: 0,
    minZoom: -Infinity,
    maxZoom: 5,
    bounds: imageBounds(satellite),
    noWrap: true,
    keepBuffer: 3,
  });
}
