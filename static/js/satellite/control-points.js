/** Control points: clicked on the image and on a slippy map, dragged, or entered in a table. */

import { byId, h, icon } from "../shared/dom.js";
import { metresText } from "../shared/format.js";
import { t } from "../shared/i18n.js";
import { clamped, latLngOf, pixelOf } from "../shared/map/coords.js";
import { imageMap } from "../shared/map/image-map.js";
import { pin } from "../shared/map/pin.js";
import { Arrows } from "../shared/map/residual-arrows.js";
import { page } from "./page.js";
import { goTo, slippyMap } from "./tile-map.js";

const FIELDS = { x: 1, y: 1, lat: 6, lon: 6 };
const NEEDED = 2;

/** The points, in both maps and in the table. A point may have only one half: pixel, or latitude and longitude. */
export class ControlPoints {
  /** @param {function(): void} changed */
  constructor(changed) {
    this.changed = changed;
    this.points = [];
    this.image = null;
    this.earth = null;
    byId("point-load").addEventListener("click", (event) => {
      event.stopPropagation(); // otherwise the map would add a point
      this._loadEarth();
    });
    byId("point-add").addEventListener("click", () => this._written(this._add()));
    byId("point-model", HTMLSelectElement).addEventListener("change", changed);
    goTo(byId("point-goto"), () => this._loadEarth());
  }

  /** Show the image; the slippy map needs a click first, as it contacts another host. */
  open() {
    if (!this.image) {
      this.image = imageMap(byId("point-image"), page.satellite);
      this.imageArrows = new Arrows(this.image);
      this.image.on("click", ({ latlng }) => this._half("x", clamped(pixelOf(latlng), page.satellite)));
    }
    this._next();
  }

  /** Body of the request; null while there are too few points. */
  wish() {
    const whole = this.points.filter(isWhole);
    if (whole.length < NEEDED) return null;
    const points = whole.map(({ x, y, lat, lon }) => ({ x, y, lat, lon }));
    return { kind: "control-points", points, model: byId("point-model", HTMLSelectElement).value || null };
  }

  /** Show the server's fit: residuals in the table, arrows in both maps. */
  show(received) {
    const whole = this.points.filter(isWhole);
    const known = received?.points?.length === whole.length ? received.points : [];
    for (const point of this.points) {
      const found = known[whole.indexOf(point)];
      point.row.querySelector("[data-part=residual]").textContent = found ? `${metresText(found.residual_m)} m` : "–";
    }
    const complete = known.filter((p) => p.fitted_x !== null && p.fitted_lat !== null);
    this.imageArrows?.show(complete.map((p) => [latLngOf([p.x, p.y]), latLngOf([p.fitted_x, p.fitted_y])]));
    this.earthArrows?.show(complete.map((p) => [L.latLng(p.lat, p.lon), L.latLng(p.fitted_lat, p.fitted_lon)]));
  }

  _loadEarth() {
    if (!this.earth) {
      byId("point-load").remove();
      this.earth = slippyMap(byId("point-earth"), byId("point-service")).map;
      this.earthArrows = new Arrows(this.earth);
      this.earth.on("click", ({ latlng }) => {
        const { lat, lng } = latlng.wrap();
        this._half("lat", [lat, lng]);
      });
      for (const point of this.points) this._draw(point);
      this.changed();
      this._next();
    }
    return this.earth;
  }

  /** Set the clicked half of a point: of an incomplete one that lacks it, or of a new one. */
  _half(first, values) {
    const names = first === "x" ? ["x", "y"] : ["lat", "lon"];
    const point = this.points.find((p) => !isWhole(p) && p[first] === null) || this._add();
    names.forEach((name, n) => (point[name] = Number(values[n].toFixed(name === "x" || name === "y" ? 2 : 8))));
    this._written(point);
  }

  _add() {
    const point = { x: null, y: null, lat: null, lon: null, pixelMarker: null, earthMarker: null };
    point.row = this._row(point);
    this.points.push(point);
    byId("points").append(point.row);
    this._number();
    return point;
  }

  _remove(point) {
    this.points = this.points.filter((p) => p !== point);
    point.row.remove();
    point.pixelMarker?.remove();
    point.earthMarker?.remove();
    this._number();
    for (const other of this.points) this._draw(other);
    this._next();
    this.changed();
    byId("point-add").focus();
  }

  _written(point) {
    for (const name of Object.keys(FIELDS)) {
      const input = point.row.querySelector(`[data-field=${name}]`);
      if (input !== document.activeElement) input.value = point[name] === null ? "" : point[name];
    }
    this._draw(point);
    this._next();
    this.changed();
  }

  /** Place the markers of a point. */
  _draw(point) {
    const number = this.points.indexOf(point) + 1;
    if (point.x !== null && point.y !== null && this.image) {
      point.pixelMarker ||= this._marker(this.image, point, (at) => {
        [point.x, point.y] = clamped(pixelOf(at), page.satellite);
      });
      point.pixelMarker.setLatLng(latLngOf([point.x, point.y])).setIcon(pin(number));
    }
    if (point.lat !== null && point.lon !== null && this.earth) {
      point.earthMarker ||= this._marker(this.earth, point, ({ lat, lng }) => {
        [point.lat, point.lon] = [Number(lat.toFixed(8)), Number(lng.toFixed(8))];
      });
      point.earthMarker.setLatLng([point.lat, point.lon]).setIcon(pin(number));
    }
  }

  _marker(map, point, take) {
    const marker = L.marker([0, 0], { draggable: true, keyboard: false, icon: pin("") }).addTo(map);
    marker.on("drag", () => {
      take(marker.getLatLng());
      this._written(point);
    });
    return marker;
  }

  _row(point) {
    const field = (name) =>
      h("td", {}, h("input", {
        class: "input number", type: "number", step: "any", inputmode: "decimal", "data-field": name,
        oninput: (event) => {
          const value = event.target.valueAsNumber;
          point[name] = Number.isFinite(value) ? value : null;
          this._written(point);
        },
      }));
    const remove = h("button", { class: "icon-button", type: "button", onclick: () => this._remove(point) }, icon("trash"));
    return h(
      "tr",
      {},
      h("th", { scope: "row" }),
      ...Object.keys(FIELDS).map(field),
      h("td", { class: "number nowrap", "data-part": "residual" }, "–"),
      h("td", {}, remove),
    );
  }

  /** Number the rows anew. */
  _number() {
    byId("points-frame").hidden = this.points.length === 0;
    const names = { x: "x", y: "y", lat: t("latitude"), lon: t("longitude") };
    this.points.forEach(({ row }, n) => {
      row.querySelector("th").textContent = n + 1;
      for (const name of Object.keys(FIELDS)) {
        row.querySelector(`[data-field=${name}]`).setAttribute("aria-label", t("Point {number}: {what}", { number: n + 1, what: names[name] }));
      }
      row.querySelector("button").setAttribute("aria-label", t("Remove point {number}", { number: n + 1 }));
    });
  }

  /** Show the next step. */
  _next() {
    const half = this.points.find((p) => !isWhole(p));
    const whole = this.points.filter(isWhole).length;
    byId("points-next").textContent = half ? this._complete(half) : ask(whole);
  }

  _complete(point) {
    const number = this.points.indexOf(point) + 1;
    if (point.x !== null) return t("Point {number}: click the same place on the map.", { number });
    if (point.lat !== null) return t("Point {number}: click the same place on the image.", { number });
    return t("Point {number}: click a place, or enter it in the table.", { number });
  }
}

function ask(whole) {
  if (whole === 0) return t("Click a spot on the image that you can also find on a map, such as a house corner or a crossroads.");
  if (whole < 4) return t("Add points, far from each other and near the corners of the image.");
  return t("More points improve the fit and reveal mistakes.");
}

function isWhole(point) {
  return Object.keys(FIELDS).every((name) => point[name] !== null);
}
