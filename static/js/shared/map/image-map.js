/** The image itself as a Leaflet map: one unit is one pixel of the image. */

import { imageBounds } from "./coords.js";
import { satelliteLayer } from "./turned-layers.js";
import { addZoomButtons } from "./zoom-buttons.js";

const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;

/**
 * Show an image.
 * @param {HTMLElement} element
 * @param {{url: string, width: number, height: number, tiles: ?Object}} satellite
 * @param {Object} [options] of Leaflet
 * @returns {L.Map}
 */
export function imageMap(element, satellite, options = {}) {
  const map = L.map(element, {
    crs: L.CRS.Simple,
    attributionControl: false,
    zoomControl: false,
    zoomSnap: 0.25,
    minZoom: -20,
    maxZoom: 5,
    zoomAnimation: !calm,
    fadeAnimation: !calm,
    ...options,
  });
  const bounds = imageBounds(satellite);
  map.fitBounds(bounds);
  map.setMaxBounds(bounds.pad(1));
  satelliteLayer(satellite).addTo(map);
  if (map.options.dragging) addZoomButtons(map, () => map.fitBounds(bounds)); // else it is a static picture
  new ResizeObserver(() => map.invalidateSize({ pan: false })).observe(element);
  return map;
}
