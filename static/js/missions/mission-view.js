/** The map of a mission: a Leaflet map on a ground, with scale bar, north arrow, cursor position and credit. */

import { h, icon } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { roundLength } from "../shared/map/coords.js";
import { placeText } from "../shared/map/positions.js";
import { lengthText } from "./format.js";

const calm = matchMedia("(prefers-reduced-motion: reduce)");
const MOTION = { zoomAnimation: !calm.matches, fadeAnimation: !calm.matches, inertia: !calm.matches };
const STRAIGHT_UP_DEG = 0.5;
/** Padding for the buttons, scale and folded legend over the map. */
const TOP = 56;
const EDGE = 16;
/** @type {[number, number]} */
const BOTTOM_RIGHT = [64, 40];
/** The legend is left of what is shown, unless it takes more of the width. */
const BESIDE = 0.3;
const ACROSS = [0, 0.5, 1];

/** The map; fires `ground` when the ground changes, `move` when the view has changed. */
export class MissionView extends EventTarget {
  /** @param {HTMLElement} element */
  constructor(element) {
    super();
    this.element = element;
    this.ground = null;
    this.map = null;
    this.layers = [];
    this._foot();
    new ResizeObserver(() => this.map?.invalidateSize({ pan: false, animate: false })).observe(element);
  }

  /** Show everything on another ground, keeping the view. @param {Object} ground */
  setGround(ground) {
    const seen = this.map && this.box(0);
    this.map?.remove();
    this.ground = ground;
    this.element.classList.toggle("mi-plain", ground.name === "plain");
    this.map = L.map(this.element, {
      crs: ground.crs, minZoom: ground.zooms.min, maxZoom: ground.zooms.max, zoomSnap: 0.25, wheelPxPerZoomLevel: 90,
      attributionControl: false, zoomControl: false, keyboard: false, boxZoom: false, ...MOTION,
    });
    this.map.setView(ground.latLngOf(ground.flat(...(ground.origin || [0, 0])) || [0, 0]), 0);
    ground.addTo(this.map);
    for (const layer of this.layers) layer.addTo(this.map);
    this.map.on("moveend", () => this._moved());
    this.map.on("mousemove", ({ latlng }) => this.showPosition(latlng));
    this.map.on("mouseout", () => this.showPosition(null));
    if (seen) this.show(seen, { pad: 0 });
    this._credit();
    this.dispatchEvent(new Event("ground"));
  }

  add(layer) {
    this.layers.push(layer);
    if (this.map) layer.addTo(this.map);
  }

  /** Show an area. @param {{south: number, west: number, north: number, east: number}} box degrees */
  show({ south, west, north, east }, { pad = 0.1, maxMetres = 60 } = {}) {
    const corners = [[south, west], [south, east], [north, west], [north, east]];
    const bounds = L.latLngBounds(corners.map(([lat, lon]) => this.ground.latLngOf(this.ground.flat(lat, lon))));
    const padded = pad ? bounds.pad(pad) : bounds;
    const most = this._zoomOf(maxMetres, padded.getCenter());
    this.map.fitBounds(padded, { animate: false, maxZoom: Math.min(most, this.ground.zooms.max), ...(pad ? this._margin() : {}) });
  }

  /** Padding around what is shown, beside or below the legend. @returns {L.FitBoundsOptions} */
  _margin() {
    const legend = this.element.parentElement.querySelector(".mi-legend");
    const taken = legend ? legend.getBoundingClientRect().right - this.element.getBoundingClientRect().left : 0;
    const beside = taken < BESIDE * this.element.clientWidth && legend?.clientHeight > TOP;
    return { paddingTopLeft: beside ? [taken + EDGE, EDGE] : [EDGE, TOP], paddingBottomRight: BOTTOM_RIGHT };
  }

  /** The zoom at which the shorter side of the screen shows some metres. */
  _zoomOf(metres, at) {
    const { x, y } = this.map.getSize();
    return this.map.getScaleZoom((Math.min(x, y) * this.ground.metresPerUnit(at)) / metres, 0);
  }

  /** The visible area, with a margin as a fraction of it. @returns {?{south, west, north, east}} degrees */
  box(margin) {
    const bounds = this.map.getBounds().pad(margin);
    const [west, east, north, south] = [bounds.getWest(), bounds.getEast(), bounds.getNorth(), bounds.getSouth()];
    const places = ACROSS.flatMap((u) => ACROSS.map((v) => this.ground.latLonOf(L.latLng(south + (north - south) * v, west + (east - west) * u))));
    if (places.some((place) => !place || !place.every(Number.isFinite))) return null;
    const [lats, lons] = [places.map(([lat]) => Math.min(Math.max(lat, -90), 90)), places.map(([, lon]) => lon)];
    return { south: Math.min(...lats), west: Math.min(...lons), north: Math.max(...lats), east: Math.max(...lons) };
  }

  /** Metres per screen pixel. */
  get metresPerPixel() {
    return this.ground.metresPerUnit(this.map.getCenter()) / this.map.getZoomScale(this.map.getZoom(), 0);
  }

  /** Pan to a position in flat coordinates unless it is in view. */
  reveal(xy, { margin = 60 } = {}) {
    const at = this.ground.latLngOf(xy);
    const { x, y } = this.map.latLngToContainerPoint(at);
    const size = this.map.getSize();
    const inside = x > margin && y > margin && x < size.x - margin && y < size.y - margin;
    if (!inside) this.map.panTo(at, { animate: !calm.matches });
  }

  zoom(steps) {
    this.map.setZoom(this.map.getZoom() + steps);
  }

  /** Show the position under the cursor or crosshair. @param {?L.LatLng} latLng */
  showPosition(latLng) {
    const place = latLng && this.ground.latLonOf(latLng);
    this._cursor.textContent = place ? placeText(place) : "";
  }

  _moved() {
    const middle = this.map.getCenter();
    const metres = this.metresPerPixel;
    const length = roundLength(110 * metres);
    this._bar.style.width = `${Math.round(length / metres)}px`;
    this._barText.textContent = lengthText(length);
    const north = this.ground.north(middle);
    this._needle.style.transform = `rotate(${north}deg)`;
    this._north.title = Math.abs(north) < STRAIGHT_UP_DEG ? t("North is up") : t("North");
    this.dispatchEvent(new Event("move"));
  }

  _foot() {
    this._bar = h("span", { class: "ed-scale-bar" });
    this._barText = h("span", { class: "ed-scale-text" });
    this._cursor = h("div", { class: "ed-cursor-position", "aria-hidden": "true" });
    this._creditBox = h("div", { class: "ed-credit" });
    this._needle = icon("north");
    this._north = h("div", { class: "mi-north", "aria-hidden": "true" }, this._needle, "N");
    const scale = h("div", { class: "ed-scale" }, this._bar, this._barText);
    this.element.append(this._north, h("div", { class: "ed-map-foot" }, scale, this._cursor, this._creditBox));
  }

  _credit() {
    const leaflet = h("a", { href: "https://leafletjs.com", rel: "noopener", target: "_blank" }, "Leaflet");
    this._creditBox.replaceChildren(...(this.ground.credit ? [this.ground.credit, " · "] : []), leaflet);
  }
}
