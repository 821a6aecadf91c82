/** The map image in Leaflet: no geographic projection; image or tiles, optional rotation, scale bar, cursor position. */

import { h, preventTextDrag } from "../dom.js";
import { locale, t } from "../i18n.js";
import { mapCredit } from "../photo-credit.js";
import { rafThrottle } from "../timing.js";
import { imageBounds, isInside, latLngOf, onScreen, panInto, pixelOf, roundLength } from "./coords.js";
import { placeText } from "./positions.js";
import { TileBackground } from "./tile-background.js";
import { turnOf } from "./turned-crs.js";
import { pictureLayer, satelliteLayer } from "./turned-layers.js";
import { TurnedMap } from "./turned-map.js";

/** Above the image of the map, below the dots. */
const FLOOR_Z = 2;
/** Opacity of the map's image below a floor. */
const UNDER_FLOOR = 0.35;
/** Opacity of a floor while it is compared with the map. */
const BLENDED = 0.55;

const calm = matchMedia("(prefers-reduced-motion: reduce)");

/** The map canvas with its satellite image. */
export class MapView {
  /**
   * @param {HTMLElement} element
   * @param {import("./map-store.js").MapStore} store
   */
  constructor(element, store) {
    this.store = store;
    this.element = element;
    this.map = new TurnedMap(element, {
      attributionControl: false,
      zoomControl: false,
      keyboard: false,
      boxZoom: false,
      doubleClickZoom: false,
      zoomSnap: 0.25,
      zoomDelta: 1,
      wheelPxPerZoomLevel: 90,
      maxZoom: 5,
      zoomAnimation: !calm.matches,
      fadeAnimation: !calm.matches,
      inertia: !calm.matches,
    });
    this.map.setView([0, 0], 0);
    this._addControls();
    this._layer = null;
    this._shown = "";
    /** @type {?{shown: string, layer: L.ImageOverlay}} layer of the floor's image, and a key of the two images */
    this._floor = null;
    /** @type {?TileBackground} */
    this._background = null;
    this._opacity = 1;
    this._blend = false;
    store.on("satellite", () => this.showSatellite());
    store.on("satellite floor", () => this._showFloor());
    store.on("photos", rafThrottle(() => this._credit()));
    this._whole = false;
    this.map.on("movestart zoomstart", () => (this._whole = false));
    new ResizeObserver(() => this._resize()).observe(element);
    preventTextDrag(element);
    this.showSatellite();
    this._showFloor();
  }

  /** Show the map's present image; the view stays if only its georeference changed. */
  showSatellite() {
    const { satellite } = this.store;
    const shown = JSON.stringify(satellite);
    this._scale();
    if (shown === this._shown) return;
    this._shown = shown;
    this._layer?.remove();
    this._layer = null;
    this._credit();
    if (!satellite) return;
    this._layer = satelliteLayer(satellite);
    this._layer.addTo(this.map);
    this._setOpacities();
    this.map.setMinZoom(-Infinity);
    this._limit();
    this.fit();
    this._limitZoom();
  }

  /** Rotate the map. @param {number} degrees clockwise on the screen */
  turnTo(degrees) {
    if (turnOf(this.map).degrees === degrees) return;
    const whole = this._whole;
    this.map.setMinZoom(-Infinity);
    this.map.turnTo(degrees);
    if (whole) this.fit();
    if (this.store.satellite) this._limitZoom();
  }

  /** Lay the image of the floor over that of the map, which stays visible around it. */
  _showFloor() {
    const { satellite, floor } = this.store;
    const url = (satellite && this.store.floorNamed(floor)?.url) || null;
    const shown = url ? `${url} ${this._shown}` : null; // the bounds depend on the map's image
    if (shown === (this._floor ? this._floor.shown : null)) return;
    const before = this._floor?.layer;
    const layer = url && pictureLayer(url, satellite, { zIndex: FLOOR_Z });
    this._floor = layer && { shown, layer };
    this._setOpacities();
    if (!layer) before?.remove();
    else layer.once("load error", () => before?.remove()).addTo(this.map); // until then the previous floor stays visible
    this._credit();
  }

  /** Make the map's image visible through that of the floor. @param {boolean} blend */
  blendFloor(blend) {
    this._blend = blend;
    this._setOpacities();
  }

  /**
   * Lay the tiles of a service below the image.
   * @param {?{url: string, attribution: string, maxZoom: number}} service null for none
   * @param {number} opacity of the image
   * @param {function({shown: number, failed: number}): void} arrived called when all tiles of a view have loaded or failed
   */
  showBackground(service, opacity, arrived) {
    const { georeference } = this.store;
    const shown = this._background;
    this._opacity = opacity;
    this._setOpacities();
    if (shown && shown.service.url === service?.url && shown.georeference === georeference) return;
    shown?.remove();
    this._background = service && new TileBackground(service, georeference, arrived).addTo(this.map);
    this._credit();
  }

  _setOpacities() {
    this._layer?.setOpacity(this._opacity * (this._floor && !this._blend ? UNDER_FLOOR : 1));
    this._floor?.layer.setOpacity(this._opacity * (this._blend ? BLENDED : 1));
  }

  /** Show the whole image. */
  fit() {
    if (!this.store.satellite) return;
    this.map.fitBounds(imageBounds(this.store.satellite), { animate: false });
    this._whole = true;
  }

  /** Keep the view near the image. */
  _limit() {
    this.map.setMaxBounds(imageBounds(this.store.satellite).pad(1));
  }

  /** Limit how far one can zoom out. */
  _limitZoom() {
    this.map.setMinZoom(this.map.getBoundsZoom(imageBounds(this.store.satellite)) - 1.5);
  }

  /** Keep showing the whole image if the view did so, else keep the view. */
  _resize() {
    if (!this.element.clientWidth) return; // hidden
    const whole = this._whole && Boolean(this.store.satellite);
    if (whole) this.map.setMaxBounds(null); // at the old zoom, the bounds would start a pan
    this.map.invalidateSize({ pan: !whole, animate: false });
    if (!whole) return;
    this.fit();
    this._limit();
    this._whole = true;
  }

  /** Pan to a map pixel unless it is in the part of the map that is on the screen; the whole image is rather left whole. */
  reveal(pixel, { margin = 40 } = {}) {
    const point = this.map.latLngToContainerPoint(latLngOf(pixel));
    const by = panInto(point, onScreen(this.element.getBoundingClientRect(), innerHeight), this._whole ? 0 : margin);
    if (by[0] || by[1]) this.map.panBy(by, { animate: !calm.matches });
  }

  /** Zoom to some map pixels. */
  focus(pixels) {
    if (!pixels.length) return;
    const bounds = L.latLngBounds(pixels.map((pixel) => latLngOf(pixel)));
    this.map.fitBounds(bounds.pad(0.3), { maxZoom: Math.max(this.map.getZoom(), 0.5), padding: [60, 60], animate: !calm.matches });
  }

  /**
   * A rectangle of the image that is in view with a margin.
   * @param {number} margin fraction of the view on each side
   * @returns {[number, number, number, number]} left, top, right, bottom; map pixels, perhaps beyond the image
   */
  inView(margin) {
    const { x: width, y: height } = this.map.getSize().divideBy(this.map.getZoomScale(this.map.getZoom(), 0));
    const [left, top, right, bottom] = turnOf(this.map).around([0, 0], [width, height]);
    const share = (0.5 - margin) * Math.min(width / (right - left), height / (bottom - top));
    const [x, y] = pixelOf(this.map.getCenter());
    return [x - share * width, y - share * height, x + share * width, y + share * height];
  }

  zoom(steps) {
    this.map.setZoom(this.map.getZoom() + steps);
  }

  /** Map pixel under a mouse event. @param {MouseEvent} event */
  pixelAt(event) {
    return pixelOf(this.map.mouseEventToLatLng(event));
  }

  _addControls() {
    this._bar = h("span", { class: "ed-scale-bar" });
    this._barText = h("span", { class: "ed-scale-text" });
    this._scaleBox = h("div", { class: "ed-scale", hidden: true }, this._bar, this._barText);
    this._cursor = h("div", { class: "ed-cursor-position", "aria-hidden": "true" });
    this._creditBox = h("div", { class: "ed-credit" });
    this.element.append(h("div", { class: "ed-map-foot" }, this._scaleBox, this._cursor, this._creditBox));
    this.map.on("zoomend moveend", () => this._scale());
    this.map.on("mousemove", (event) => this.showPosition(pixelOf(event.latlng)));
    this.map.on("mouseout", () => this.showPosition(null));
  }

  /** Show the position under the cursor or crosshair. @param {?number[]} pixel */
  showPosition(pixel) {
    const { satellite } = this.store;
    this._cursor.textContent = pixel && satellite && isInside(pixel, satellite) ? this.positionText(pixel) : "";
  }

  /** A map pixel as text, with latitude and longitude if known. */
  positionText(pixel) {
    const place = `x ${Math.round(pixel[0])}, y ${Math.round(pixel[1])}`;
    const latLon = this.store.georeference.latLon(pixel);
    return latLon ? `${place}  ·  ${placeText(latLon)}` : place;
  }

  _scale() {
    const metres = this.store.georeference.metresPerPixel;
    this._scaleBox.hidden = !metres;
    if (!metres) return;
    const metresPerScreen = metres / this.map.getZoomScale(this.map.getZoom(), 0);
    const length = roundLength(110 * metresPerScreen);
    this._bar.style.width = `${Math.round(length / metresPerScreen)}px`;
    this._barText.textContent = length >= 1000 ? `${(length / 1000).toLocaleString(locale)} km` : `${length.toLocaleString(locale)} m`;
  }

  _credit() {
    const known = [this.store.satellite?.attribution, this.store.floorNamed(this.store.floor)?.attribution, mapCredit(this.store.photos.values()), this._background?.service.attribution];
    const credits = [...new Set(known.filter(Boolean))].join(" · ");
    if (credits === this._credits) return;
    this._credits = credits;
    const leaflet = h("a", { href: "https://leafletjs.com", rel: "noopener", target: "_blank" }, "Leaflet");
    this._creditBox.replaceChildren(...(credits ? [credits, " · "] : []), leaflet);
    this._creditBox.title = t("Shown with Leaflet");
  }
}
