/** The image of a map, as one picture or in tiles, on a map that may draw it turned. */

import { imageBounds } from "./coords.js";
import { turnOf, UPRIGHT } from "./turned-crs.js";

const TILE = 256;

/** Like `L.DomUtil.setTransform`, and turned. @param {HTMLElement} element @param {L.Point} at */
function place(element, { x, y }, scale, turn) {
  element.style.transformOrigin = "0 0"; // Leaflet's own style sheet has it only for what is animated
  element.style.transform = `translate3d(${x}px, ${y}px, 0) rotate(${turn.degrees}deg) scale(${scale})`;
}

/** A picture between bounds. What begins with an underscore replaces methods of Leaflet here. */
class TurnedImage extends L.ImageOverlay {
  /** As in Leaflet, and turned. */
  _reset() {
    const { _map: map, _image: image, _bounds: bounds } = /** @type {*} */ (this);
    const scale = map.getZoomScale(map.getZoom(), 0);
    const at = map.latLngToLayerPoint(bounds.getNorthWest());
    image.style.width = `${(bounds.getEast() - bounds.getWest()) * scale}px`;
    image.style.height = `${(bounds.getNorth() - bounds.getSouth()) * scale}px`;
    place(image, at, 1, turnOf(map));
  }

  /** As in Leaflet, and turned. */
  _animateZoom(event) {
    const { _map: map, _image: image, _bounds: bounds } = /** @type {*} */ (this);
    const at = map._latLngToNewLayerPoint(bounds.getNorthWest(), event.zoom, event.center);
    place(image, at, map.getZoomScale(event.zoom), turnOf(map));
  }
}

/** Tiles of an image: their grid is that of the image, and each level of them is turned as a whole. */
class TurnedTiles extends L.TileLayer {
  /** @override @param {L.Map} map */
  onAdd(map) {
    this.on("tileloadstart", this._lay, this);
    return super.onAdd(map);
  }

  /** Tiles of one level are to be turned as one picture: laid by transforms of their own, they would show seams. */
  _lay({ tile, coords }) {
    if (turnOf(this._map) === UPRIGHT) return;
    const { x, y } = this._getTilePos(coords);
    Object.assign(tile.style, { transform: "none", left: `${x}px`, top: `${y}px`, willChange: "auto" });
  }

  /** Where a level is drawn. */
  _setZoomTransform(level, centre, zoom) {
    const map = /** @type {*} */ (this._map);
    const turn = turnOf(map);
    // where the tiles of the level count from; whole pixels of the tiles, so that these are drawn sharp
    level.corner ??= L.point(turn.back([level.origin.x, level.origin.y])).round();
    const scale = map.getZoomScale(zoom, level.zoom);
    const at = L.point(turn.forth([level.corner.x, level.corner.y])).multiplyBy(scale).subtract(map._getNewPixelOrigin(centre, zoom));
    place(level.el, at.round(), scale, turn);
  }

  /** Where a tile is in its level. */
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

/** The image of a map, in tiles where it has them. @param {{url: string, width: number, height: number, tiles: ?Object}} satellite */
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
