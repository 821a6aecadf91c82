/** Distances on the image: each click adds a point, Escape or "Done" ends. */

import { byId } from "../shared/dom.js";
import { locale, t, tn } from "../shared/i18n.js";
import { latLngOf } from "../shared/map/coords.js";

/** A line of points with its length, in metres if the map has a georeference. */
export class Measure {
  /**
   * @param {import("../shared/map/map-view.js").MapView} view
   * @param {function(string): void} say announces to a screen reader
   */
  constructor(view, say) {
    this.view = view;
    this.say = say;
    this.points = [];
    this.active = false;
    this.line = L.polyline([], { className: "ed-measure", interactive: false });
    this.ends = L.layerGroup();
    byId("measure").addEventListener("click", () => (this.active ? this.stop() : this.start()));
    byId("measure-back").addEventListener("click", () => this.back());
    byId("measure-done").addEventListener("click", () => this.stop());
    view.store.on("satellite", () => this.stop());
  }

  /** Begin, optionally with a first point. @param {?number[]} [pixel] */
  start(pixel = null) {
    this.active = true;
    this.points = [];
    for (const layer of [this.line, this.ends]) layer.addTo(this.view.map);
    if (pixel) this.add(pixel);
    else this._show();
  }

  stop() {
    this.active = false;
    this.line.remove();
    this.ends.remove();
    this._show();
  }

  /** @param {number[]} pixel */
  add(pixel) {
    this.points.push(pixel);
    this._show();
    if (this.points.length > 1) this.say(this.length());
  }

  /** Remove the last point. */
  back() {
    this.points.pop();
    this._show();
  }

  /** The length as text. */
  length() {
    const { georeference } = this.view.store;
    const legs = this.points.slice(1).map((to, n) => [this.points[n], to]);
    const metres = legs.map(([from, to]) => georeference.metres(from, to));
    if (metres.some((leg) => leg === null)) {
      const pixels = legs.reduce((sum, [from, to]) => sum + Math.hypot(to[0] - from[0], to[1] - from[1]), 0);
      return tn("{n} pixel", "{n} pixels", Math.round(pixels));
    }
    const all = metres.reduce((sum, leg) => sum + leg, 0);
    const [value, unit] = all >= 10_000 ? [all / 1000, "km"] : [all, "m"];
    return `${value.toLocaleString(locale, { maximumFractionDigits: value < 100 ? 1 : 0 })} ${unit}`;
  }

  _show() {
    const places = this.points.map((pixel) => latLngOf(pixel));
    this.line.setLatLngs(places);
    this.ends.clearLayers();
    for (const place of places) L.circleMarker(place, { radius: 4, className: "ed-measure-point", interactive: false }).addTo(this.ends);
    byId("measure").setAttribute("aria-pressed", String(this.active));
    byId("measure-bar").hidden = !this.active;
    byId("measure-back", HTMLButtonElement).disabled = !this.points.length;
    byId("measure-length").textContent = this.points.length > 1 ? this.length() : t("Click the points to measure along.");
    this.view.element.classList.toggle("is-measuring", this.active);
  }
}
