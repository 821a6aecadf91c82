/** Slippy maps of the configured tile services, which are not contacted before one is shown. */

import { t } from "../shared/i18n.js";
import { parsePosition } from "../shared/map/grids.js";
import { areas } from "../shared/map/tile-address.js";
import { addZoomButtons } from "../shared/map/zoom-buttons.js";
import { toast } from "../shared/toast.js";
import { page } from "./page.js";

const PLACE = "expmap-image-place";
const EUROPE = { center: [49, 12], zoom: 4 };
const calm = matchMedia("(prefers-reduced-motion: reduce)").matches;

/**
 * Make a slippy map at the photos or the image, else at the last position.
 * @param {HTMLElement} element
 * @param {HTMLSelectElement} select of the service
 * @param {{load?: ?HTMLButtonElement}} [options] `load`: a button to press before tiles are requested
 * @returns {{map: L.Map, service: function(): Object}}
 */
export function slippyMap(element, select, { load = null } = {}) {
  const motion = { zoomAnimation: !calm, fadeAnimation: !calm, inertia: !calm };
  const map = L.map(element, { maxZoom: 22, worldCopyJump: true, zoomControl: false, ...motion });
  addZoomButtons(map);
  map.attributionControl.setPrefix('<a href="https://leafletjs.com" rel="noopener" target="_blank">Leaflet</a>');
  let layer = null;
  const service = () => page.services[select.selectedIndex];
  const show = () => {
    layer?.remove();
    layer = tiles(service()).addTo(map);
  };
  const begin = () => {
    select.addEventListener("change", show);
    show();
    if (load) load.hidden = true;
  };
  beginAt(map);
  if (load) {
    load.hidden = false;
    load.addEventListener("click", begin);
  } else begin();
  map.on("moveend", () => {
    const { lat, lng } = map.getCenter();
    localStorage.setItem(PLACE, JSON.stringify({ center: [lat, lng], zoom: map.getZoom() }));
  });
  new ResizeObserver(() => map.invalidateSize({ pan: false })).observe(element);
  return { map, service };
}

/**
 * Let a field move a map to an entered position.
 * @param {HTMLInputElement} input
 * @param {function(): ?L.Map} map
 * @param {?function(string): void} [search] called on request with text that is no position
 */
export function goTo(input, map, search = null) {
  const go = ({ asked }) => {
    const place = onTiles(parsePosition(input.value));
    const text = input.value.trim();
    if (place) map()?.setView(place, Math.max(map().getZoom(), 16));
    else if (text && search) asked && search(text);
    else if (text) toast(t("Enter it as 50.0875, 14.4213, or in UTM or MGRS"), { kind: "error" });
  };
  input.addEventListener("change", () => go({ asked: false }));
  input.addEventListener("keydown", (event) => {
    if (event.key !== "Enter") return;
    event.preventDefault();
    go({ asked: true });
  });
  return () => go({ asked: true });
}

/** A position that web maps have: they end near the poles. @param {?[number, number]} place */
function onTiles(place) {
  return place && Math.abs(place[0]) <= 85 ? place : null;
}

/**
 * Let a button move a map to the position of the device.
 * @param {HTMLButtonElement} button
 * @param {function(): ?L.Map} map
 */
export function goHere(button, map) {
  button.hidden = !navigator.geolocation;
  button.addEventListener("click", () => {
    navigator.geolocation.getCurrentPosition(
      ({ coords }) => map()?.setView([coords.latitude, coords.longitude], 17),
      () => toast(t("This device does not share its location."), { kind: "error" }),
    );
  });
}

function tiles({ url, attribution, max_zoom }) {
  return L.tileLayer(url, {
    ...areas,
    attribution: escaped(attribution),
    maxNativeZoom: max_zoom,
    maxZoom: 22,
    // tile services require the referring site; send no more than its origin
    referrerPolicy: "strict-origin-when-cross-origin",
  });
}

function escaped(text) {
  const made = document.createElement("span");
  made.textContent = text;
  return made.innerHTML;
}

/** The eastern edge of an area; beyond 180 degrees if the area crosses the antimeridian. */
export function eastOf({ west, east }) {
  return east < west ? east + 360 : east;
}

function beginAt(map) {
  const corners = Object.values(page.earth?.corners || {}).filter(Boolean);
  const { photos } = page;
  if (corners.length) map.fitBounds(L.latLngBounds(corners.map(({ lat, lon }) => L.latLng(lat, lon))), { maxZoom: 19 });
  else if (photos) {
    map.fitBounds(L.latLngBounds([photos.south, photos.west], [photos.north, eastOf(photos)]).pad(0.1), { maxZoom: 19 });
  } else {
    /** @type {{center: [number, number], zoom: number}} */
    const { center, zoom } = JSON.parse(localStorage.getItem(PLACE) || "null") || EUROPE;
    map.setView(center, zoom);
  }
}
