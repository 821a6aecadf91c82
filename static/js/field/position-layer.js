/** The phone on the image: a dot at its position, the circle of its accuracy, and its heading. */

import { byId } from "../shared/dom.js";
import { metresText } from "../shared/format.js";
import { t } from "../shared/i18n.js";
import { CanvasLayer } from "../shared/map/canvas-layer.js";
import { isInside, latLngOf } from "../shared/map/coords.js";
import { PixelFromLatLon } from "../shared/map/latlon-to-pixel.js";

const RADIUS = 8;
const BEAM = 34;
const HALF_BEAM = Math.PI / 6;

/** A Leaflet layer, and the button that starts positioning. */
export class PositionLayer extends CanvasLayer {
  /**
   * @param {import("../shared/map/map-view.js").MapView} view
   * @param {import("./pose.js").PhonePose} pose
   */
  constructor(view, pose) {
    super();
    this.view = view;
    this.pose = pose;
    this.georeference = view.store.georeference;
    this.pixelFrom = new PixelFromLatLon(this.georeference);
    this.wanted = false; // whether to bring the position into view once it is known
    const button = byId("locate");
    button.hidden = !this.pixelFrom.plane;
    button.addEventListener("click", () => this._locate());
    pose.addEventListener("change", () => this._changed());
    this.addTo(view.map);
  }

  /** Map pixel of the phone. @returns {?number[]} */
  get pixel() {
    const { position } = this.pose;
    return position && this.pixelFrom.find(position.lat, position.lon);
  }

  async _locate() {
    this.wanted = true;
    await this.pose.start();
    this._changed();
  }

  _changed() {
    const { position, problem } = this.pose;
    const { pixel } = this;
    const text = byId("here");
    text.hidden = false;
    if (problem) text.textContent = t("The position of this device is not known: {reason}", { reason: problem });
    else if (!position) text.textContent = t("Looking for your position …");
    else if (!isInside(pixel, this.view.store.satellite)) text.textContent = t("You are outside of this image.");
    else {
      text.textContent = t("You are here, within {distance} m", { distance: metresText(Math.max(1, Math.round(position.accuracy))) });
      if (this.wanted) this.view.reveal(pixel);
      this.wanted = false;
    }
    this._draw();
  }

  /** @override */
  paint(pen) {
    const { pixel, pose } = this;
    if (!pixel) return;
    const { x, y } = this._map.latLngToContainerPoint(latLngOf(pixel));
    const style = getComputedStyle(this._canvas);
    const colour = (name) => style.getPropertyValue(`--map-${name}`).trim();
    this._accuracy(pen, { x, y, fill: colour("gps-fill"), line: colour("gps") });
    if (pose.heading !== null) this._beam(pen, { x, y, fill: colour("current-wedge"), rim: colour("rim") });
    pen.beginPath();
    pen.arc(x, y, RADIUS, 0, 2 * Math.PI);
    Object.assign(pen, { fillStyle: colour("gps"), strokeStyle: colour("rim"), lineWidth: 3 });
    pen.fill();
    pen.stroke();
  }

  _accuracy(pen, { x, y, fill, line }) {
    const pixels = this.pose.position.accuracy / this.georeference.metresPerPixel;
    const radius = pixels * this._map.getZoomScale(this._map.getZoom(), 0);
    pen.beginPath();
    pen.arc(x, y, radius, 0, 2 * Math.PI);
    Object.assign(pen, { fillStyle: fill, strokeStyle: line, lineWidth: 2 });
    pen.fill();
    pen.stroke();
  }

  _beam(pen, { x, y, fill, rim }) {
    const middle = this.angleOf(this.pose.heading + this.georeference.north(this.pixel));
    pen.beginPath();
    pen.moveTo(x, y);
    pen.arc(x, y, BEAM, middle - HALF_BEAM, middle + HALF_BEAM);
    pen.closePath();
    Object.assign(pen, { fillStyle: fill, strokeStyle: rim, lineWidth: 1.5 });
    pen.fill();
    pen.stroke();
  }
}
