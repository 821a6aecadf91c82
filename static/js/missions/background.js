/**
 * Backgrounds of tracks: the image of a map, a plain plane in metres, or the tiles of a service.
 *
 * Each ground converts latitude and longitude to flat coordinates (x to the right, y down): pixels of its Leaflet map
 * at zoom 0. On the screen they are only scaled and shifted, so a track is converted once.
 */

import { Georeference, imageBounds, latLngOf, pixelOf } from "../shared/map/coords.js";
import { PixelFromLatLon } from "../shared/map/latlon-to-pixel.js";
import { areas } from "../shared/map/tile-address.js";
import { satelliteLayer } from "../shared/map/turned-layers.js";

const EQUATOR_M = 6378137;
const ECCENTRICITY_2 = 0.00669437999014;
const WORLD = 256;
const RADIANS = Math.PI / 180;

/** The satellite image of a map, through its georeference. */
export class ImageGround {
  constructor(satellite) {
    this.name = "image";
    this.satellite = satellite;
    this.georeference = new Georeference(satellite.georeference, satellite);
    this.toPixel = new PixelFromLatLon(this.georeference);
    this.crs = L.CRS.Simple;
    this.bounds = imageBounds(satellite);
    this.credit = satellite.attribution;
    this.zooms = { min: -8, max: 6 };
  }

  flat(lat, lon) {
    return this.toPixel.find(lat, lon);
  }

  latLonOf(latLng) {
    return this.georeference.latLon(pixelOf(latLng));
  }

  latLngOf(xy) {
    return latLngOf(xy);
  }

  north(latLng) {
    return this.georeference.north(pixelOf(latLng));
  }

  metresPerUnit() {
    return this.georeference.metresPerPixel || 1;
  }

  addTo(map) {
    satelliteLayer(this.satellite).addTo(map);
  }
}

/** A plane tangent to the ellipsoid (WGS 84) at an origin, in metres: x to the east, y to the south. */
export class PlainGround {
  constructor([lat, lon]) {
    this.name = "plain";
    this.origin = [lat, lon];
    const bend = 1 - ECCENTRICITY_2 * Math.sin(lat * RADIANS) ** 2;
    this.metresPerLat = ((EQUATOR_M * (1 - ECCENTRICITY_2)) / bend ** 1.5) * RADIANS;
    this.metresPerLon = (EQUATOR_M / Math.sqrt(bend)) * Math.cos(lat * RADIANS) * RADIANS;
    this.crs = L.CRS.Simple;
    this.bounds = null;
    this.credit = null;
    this.zooms = { min: -16, max: 7 };
  }

  flat(lat, lon) {
    return [turned(lon - this.origin[1]) * this.metresPerLon, (this.origin[0] - lat) * this.metresPerLat];
  }

  /** @returns {[number, number]} */
  latLonOf(latLng) {
    const [x, y] = pixelOf(latLng);
    return [this.origin[0] - y / this.metresPerLat, turned(this.origin[1] + x / this.metresPerLon)];
  }

  latLngOf(xy) {
    return latLngOf(xy);
  }

  north() {
    return 0;
  }

  metresPerUnit() {
    return 1;
  }

  addTo() {}
}

/** Web Mercator with the tiles of a configured service. */
export class TileGround {
  constructor(service) {
    this.name = service.name;
    this.service = service;
    this.crs = L.CRS.EPSG3857;
    this.bounds = null;
    this.credit = service.attribution;
    this.zooms = { min: 1, max: 22 };
  }

  flat(lat, lon) {
    const sine = Math.min(Math.max(Math.sin(lat * RADIANS), -0.9999), 0.9999);
    return [(lon / 360 + 0.5) * WORLD, (0.5 - Math.atanh(sine) / (2 * Math.PI)) * WORLD];
  }

  latLonOf({ lat, lng }) {
    return [lat, turned(lng)];
  }

  latLngOf([x, y]) {
    return this.crs.pointToLatLng(L.point(x, y), 0);
  }

  north() {
    return 0;
  }

  metresPerUnit({ lat }) {
    return ((2 * Math.PI * EQUATOR_M) / WORLD) * Math.cos(lat * RADIANS);
  }

  addTo(map) {
    const { url, max_zoom: most } = this.service;
    // tile services require the referring site; send no more than its origin
    L.tileLayer(url, { ...areas, maxNativeZoom: most, maxZoom: 22, referrerPolicy: "strict-origin-when-cross-origin" }).addTo(map);
  }
}

/** An angle in [-180, 180). */
function turned(degrees) {
  return ((((degrees + 180) % 360) + 360) % 360) - 180;
}
