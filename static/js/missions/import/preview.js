/** Preview of an import: the tracks of a file at their positions, and the robot's start, set by clicks. */

import { h, icon } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";
import { ImageGround, PlainGround } from "../background.js";
import { MissionView } from "../mission-view.js";
import { PreviewLayer } from "./preview-layer.js";
import { headingTo, laid, placeAhead } from "./start-pose.js";

const ARROW_PX = 56;
const NEAREST_PX = 10;
const A_FEW_METRES = 1e-4; // degrees
/** Origin for tracks in metres while no position on the Earth is known. */
const NOWHERE = { lat: 0, lon: 0, heading_deg: 0 };

/**
 * @typedef {Object} Place surroundings of the tracks
 * @property {?Object} satellite image of the map, with its georeference
 * @property {Array<Array<[number, number]>>} lines tracks already in the mission: latitudes and longitudes
 */

/** The map of the dialog, in `element`. */
export class Preview {
  /** @param {import("./start-pose.js").StartPose} start */
  constructor(start) {
    this.start = start;
    /** @type {Place} */
    this.place = { satellite: null, lines: [] };
    this.sources = [];
    this._pointed = null; // heading of the pointer from the start, before the second click
    this._made = ""; // key of the present ground; empty before the first `show`, as a hidden map has no size
    this._dragged = null;
    this._canvas = h("div", { class: "ed-canvas", "data-testid": "import-picture", role: "group", "aria-label": t("Picture of the tracks") });
    this._hint = h("p", { class: "im-hint small", "aria-live": "polite", "data-testid": "import-hint" });
    this._again = h("button", { class: "button button--quiet im-again", type: "button", onclick: () => this._startAgain() }, icon("retry"), t("Set the start again"));
    const zoom = h("div", { class: "ed-zoom", role: "group", "aria-label": t("Zoom") },
      h("button", { class: "icon-button", type: "button", "aria-label": t("Zoom in"), onclick: () => this.view.zoom(1) }, icon("plus")),
      h("button", { class: "icon-button", type: "button", "aria-label": t("Zoom out"), onclick: () => this.view.zoom(-1) }, icon("minus")),
      h("button", { class: "icon-button", type: "button", "aria-label": t("Show everything"), onclick: () => this._fit() }, icon("fit")));
    this._below = h("div", { class: "im-below" }, this._hint, this._again);
    this.element = h("div", { class: "im-picture" }, h("div", { class: "ed-map im-map" }, this._canvas, zoom), this._below);
    this.view = new MissionView(this._canvas);
    this.layer = new PreviewLayer(this.view);
    this.view.add(this.layer);
    this._handles = this._startHandles();
    this.view.addEventListener("ground", () => this._listen());
    this.view.addEventListener("move", () => this._placeHandles());
    start.addEventListener("change", () => this._follow());
  }

  /** @param {Place} place */
  setPlace(place) {
    this.place = place;
    if (this._made) this.show(this.sources);
  }

  /** Show the tracks of a file. @param {Array<Object>} sources as returned by the server */
  show(sources) {
    const before = this.sources;
    this.sources = sources;
    this._settle();
    this._draw();
    if (before.length !== sources.length || before.some((one, n) => one !== sources[n])) this._fit();
  }

  /** Whether a start is needed and can be set by clicks. */
  get _takesClicks() {
    return this._needsStart && this.view.ground && !this._isNowhere;
  }

  get _needsStart() {
    return this.sources.some(({ frame }) => frame === "robot");
  }

  get _isNowhere() {
    return this._made === "nowhere";
  }

  /** Choose the ground, and keep it as long as it is suitable. */
  _settle() {
    const known = [...this.place.lines, ...this.sources.filter(({ frame }) => frame === "earth").map(({ line }) => line)];
    const first = known.find((line) => line.length)?.[0] ?? this.start.position;
    const image = imageUnder(this.place.satellite, known);
    const name = image ? `image ${this.place.satellite.url}` : first ? "plain" : "nowhere";
    if (name === this._made) return;
    this._made = name;
    this.view.setGround(image ?? new PlainGround(first ?? [NOWHERE.lat, NOWHERE.lon]));
    this._fit();
  }

  /** The tracks as they would be imported: `{source, latlon}`. */
  _lines() {
    const start = this._shownStart();
    return this.sources.flatMap(({ source, frame, line }) => {
      if (frame === "earth") return [{ source, latlon: line }];
      return start ? [{ source, latlon: laid(line, start) }] : [];
    });
  }

  /** The start to draw: the chosen one, or with the heading of the pointer. */
  _shownStart() {
    const { whole, position } = this.start;
    if (whole) return whole;
    if (position && this._pointed !== null) return { lat: position[0], lon: position[1], heading_deg: this._pointed };
    return this._isNowhere ? NOWHERE : null;
  }

  _draw() {
    if (this._isNowhere && this.start.position) this._settle();
    if (!this.view.ground) return;
    this.layer.setLines([...this.place.lines.map((latlon) => ({ source: null, latlon })), ...this._lines()]);
    this._canvas.classList.toggle("is-placing", Boolean(this._takesClicks && !this.start.whole));
    this._below.hidden = !this._needsStart;
    this._hint.textContent = this._instruction();
    this._again.hidden = !this._takesClicks || this.start.isEmpty;
    this._placeHandles();
  }

  /** Redraw, and bring the start into view: it may have been entered as numbers. */
  _follow() {
    this._draw();
    const { whole } = this.start;
    if (whole && this.view.map && !this.view.map.getBounds().contains(this._latLngOf([whole.lat, whole.lon]))) this._fit();
  }

  _instruction() {
    if (this._isNowhere) return t("In metres from the start: choose a map to click on, or enter the start as coordinates.");
    if (!this.start.position) return t("Click where the robot started.");
    if (this.start.heading === null) return t("Click in the direction it was facing.");
    return t("Drag the start or the tip of the arrow to correct them.");
  }

  _startAgain() {
    this._pointed = null;
    this.start.set([null, null, null]);
  }

  _fit() {
    if (!this.view.map) return;
    const places = this._lines().flatMap(({ latlon }) => latlon);
    const all = places.length ? places : this.place.lines.flat();
    if (all.length) {
      const [lats, lons] = [all.map(([lat]) => lat), all.map(([, lon]) => lon)];
      this.view.show({ south: least(lats), west: least(lons), north: most(lats), east: most(lons) });
    } else if (this.view.ground.bounds) {
      this.view.map.fitBounds(this.view.ground.bounds, { animate: false });
    } else {
      const [lat, lon] = this.view.ground.origin;
      this.view.show({ south: lat, west: lon, north: lat + A_FEW_METRES, east: lon + A_FEW_METRES });
    }
  }

  _listen() {
    const { map } = this.view;
    map.doubleClickZoom.disable(); // two clicks set the start
    map.on("click", ({ latlng }) => this._click(latlng));
    map.on("mousemove", ({ latlng }) => this._point(latlng));
  }

  _click(latlng) {
    const place = this.view.ground.latLonOf(latlng);
    if (!this._takesClicks || this.start.whole || !place) return;
    if (!this.start.position) this.start.moveTo(place);
    else if (!this._isNear(latlng)) this.start.turnTo(headingTo(this.start.position, place));
    this._pointed = null;
  }

  /** Let the track follow the pointer until the heading is set. */
  _point(latlng) {
    const { position, heading } = this.start;
    const place = this.view.ground.latLonOf(latlng);
    if (!this._takesClicks || !position || heading !== null || !place || this._isNear(latlng)) return;
    this._pointed = headingTo(position, place);
    this._draw();
  }

  /** Whether a position is too close to the start to define a heading. */
  _isNear(latlng) {
    const { map } = this.view;
    const start = map.latLngToContainerPoint(this._latLngOf(this.start.position));
    return start.distanceTo(map.latLngToContainerPoint(latlng)) < NEAREST_PX;
  }

  _latLngOf([lat, lon]) {
    const { ground } = this.view;
    return ground.latLngOf(ground.flat(lat, lon));
  }

  /** Draggable handles of the start and the tip of its arrow. */
  _startHandles() {
    const handle = (kind, moved) => {
      const marker = L.marker([0, 0], { draggable: true, keyboard: false, icon: L.divIcon({ className: `im-handle im-handle--${kind}`, iconSize: [28, 28] }) });
      marker.on("drag", () => {
        const place = this.view.ground.latLonOf(marker.getLatLng());
        if (place) moved(place);
      });
      marker.on("dragstart", () => (this._dragged = marker));
      marker.on("dragend", () => {
        this._dragged = null;
        this._placeHandles();
      });
      return marker;
    };
    const group = L.layerGroup();
    this.view.add(group);
    return {
      group,
      from: handle("start", (place) => this.start.moveTo(place)),
      tip: handle("tip", (place) => this.start.turnTo(headingTo(this.start.position, place))),
    };
  }

  _placeHandles() {
    const { group, from, tip } = this._handles;
    const position = this._takesClicks ? this.start.position : null;
    const start = position && this._shownStart();
    this._toggle(group, from, position && this._latLngOf(position));
    const ahead = start && this._latLngOf(placeAhead(start, ARROW_PX * this.view.metresPerPixel));
    this._toggle(group, tip, this.start.whole && ahead);
    this.layer.setArrow(start && [this._latLngOf(position), ahead]);
  }

  /** Show a marker at a position, or hide it; one being dragged is not moved. */
  _toggle(group, marker, latLng) {
    if (!latLng) return group.removeLayer(marker);
    if (marker !== this._dragged) marker.setLatLng(latLng);
    return group.addLayer(marker);
  }
}

/** The image of a map if it is georeferenced and overlaps some of the tracks, or if there are none. */
function imageUnder(satellite, lines) {
  const places = satellite?.georeference?.latlon_grid?.latlon.filter(Boolean);
  if (!places?.length) return null;
  const [lats, lons] = [places.map(([lat]) => lat), places.map(([, lon]) => lon)];
  const isOn = ([lat, lon]) => lat >= least(lats) && lat <= most(lats) && lon >= least(lons) && lon <= most(lons);
  return !lines.length || lines.some((line) => line.some(isOn)) ? new ImageGround(satellite) : null;
}

const least = (values) => values.reduce((a, b) => Math.min(a, b), Infinity);
const most = (values) => values.reduce((a, b) => Math.max(a, b), -Infinity);
