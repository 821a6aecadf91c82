/** Distances and bearings on a map: each click adds a point, Escape or "Done" ends. */

import { byId } from "../dom.js";
import { locale, t, tn } from "../i18n.js";
import { bearingDeg, groundMetres } from "./coords.js";

/**
 * Where one measures. A point is whatever `latLng` and `latLon` take.
 * @typedef {Object} Surface
 * @property {HTMLElement} element
 * @property {?L.Map} map
 * @property {function(number[]): ?L.LatLng} latLng where a point is drawn; null if the map has no such place
 * @property {function(number[]): ?number[]} latLon latitude and longitude of a point; null if unknown
 */

/** A line of points with its length, in metres where positions are known, and the length and true bearing of its last leg. */
export class Measure {
  /**
   * @param {Surface} surface
   * @param {function(string): void} [say] announces to a screen reader
   */
  constructor(surface, say = () => {}) {
    this.surface = surface;
    this.say = say;
    this.points = [];
    this.active = false;
    this.line = L.polyline([], { className: "ed-measure", interactive: false });
    this.ends = L.layerGroup();
    byId("measure").addEventListener("click", () => this.toggle());
    byId("measure-back").addEventListener("click", () => this.back());
    byId("measure-done").addEventListener("click", () => this.stop());
  }

  toggle() {
    if (this.active) this.stop();
    else this.start();
  }

  /** Begin, optionally with a first point. @param {?number[]} [point] */
  start(point = null) {
    if (!this.surface.map) return;
    this.active = true;
    this.points = [];
    if (point) this.add(point);
    else this.show();
  }

  stop() {
    this.active = false;
    this.show();
  }

  /** @param {number[]} point */
  add(point) {
    this.points.push(point);
    this.show();
    if (this.points.length > 1) this.say([this.length(), this.leg()].filter(Boolean).join(", "));
  }

  /** Remove the last point. */
  back() {
    this.points.pop();
    this.show();
  }

  /** The length as text. */
  length() {
    const legs = this.points.slice(1).map((to, n) => [this.points[n], to]);
    const metres = legs.map((leg) => this._metres(leg));
    if (metres.some((leg) => leg === null)) {
      const pixels = legs.reduce((sum, [from, to]) => sum + Math.hypot(to[0] - from[0], to[1] - from[1]), 0);
      return tn("{n} pixel", "{n} pixels", Math.round(pixels));
    }
    return measured(metres.reduce((sum, leg) => sum + leg, 0));
  }

  /** Length and bearing of the last leg as text; of a single one, the bearing. */
  leg() {
    const leg = this.points.slice(-2);
    const metres = leg.length === 2 ? this._metres(leg) : null;
    if (!metres) return "";
    const [from, to] = this._places(leg);
    const bearing = `${Math.round(bearingDeg(from, to)) % 360}°`;
    return this.points.length === 2 ? bearing : t("last leg {length}, {bearing}", { length: measured(metres), bearing });
  }

  _metres(leg) {
    const [from, to] = this._places(leg);
    return from && to ? groundMetres(from, to) : null;
  }

  _places(leg) {
    return leg.map((point) => this.surface.latLon(point));
  }

  /** Draw the points, also on another map. */
  show() {
    const { surface, active } = this;
    for (const layer of [this.line, this.ends]) {
      layer.remove();
      if (active) layer.addTo(surface.map);
    }
    const places = active ? this.points.map((point) => surface.latLng(point)).filter(Boolean) : [];
    this.line.setLatLngs(places);
    this.ends.clearLayers();
    for (const place of places) L.circleMarker(place, { radius: 4, className: "ed-measure-point", interactive: false }).addTo(this.ends);
    byId("measure").setAttribute("aria-pressed", String(active));
    byId("measure-bar").hidden = !active;
    byId("measure-back", HTMLButtonElement).disabled = !this.points.length;
    byId("measure-length").textContent = this.points.length > 1 ? this.length() : t("Click the points to measure along.");
    byId("measure-leg").textContent = this.leg();
    surface.element.classList.toggle("is-measuring", active);
  }
}

/** @param {number} metres */
function measured(metres) {
  const [value, unit] = metres >= 10_000 ? [metres / 1000, "km"] : [metres, "m"];
  return `${value.toLocaleString(locale, { maximumFractionDigits: value < 100 ? 1 : 0 })} ${unit}`;
}
