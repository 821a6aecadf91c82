/** A crosshair on the image, for placing by the keyboard. */

import { h } from "../dom.js";
import { clamped, latLngOf, pixelOf } from "./coords.js";

/** A crosshair that arrow keys move. */
export class Crosshair {
  /**
   * @param {import("./map-view.js").MapView} view
   * @param {function(string): void} say
   */
  constructor(view, say) {
    this.view = view;
    this.say = say;
    this.pixel = null;
    this.element = view.element.appendChild(h("div", { class: "ed-crosshair", hidden: true, "aria-hidden": "true" }));
    view.map.on("move zoom zoomend moveend resize", () => this._show());
    view.element.addEventListener("pointerdown", () => this.hide());
    view.element.addEventListener("blur", () => this.hide());
    view.element.addEventListener("focus", () => view.element.matches(":focus-visible") && this.start());
  }

  get visible() {
    return !this.element.hidden;
  }

  /** Show it at its last position, or in the middle of the view. */
  start() {
    if (!this.view.store.satellite) return;
    const { map } = this.view;
    if (!this.pixel || !L.bounds([0, 0], map.getSize()).contains(this.point)) {
      this.pixel = clamped(pixelOf(map.getCenter()), this.view.store.satellite);
    }
    this.element.hidden = false;
    this._show();
  }

  hide() {
    this.element.hidden = true;
  }

  /** Move it by some pixels of the screen; the image follows. */
  move(dx, dy) {
    if (!this.visible) this.start();
    if (!this.pixel) return;
    const { map } = this.view;
    const there = map.project(latLngOf(this.pixel), map.getZoom()).add([dx, dy]);
    this.pixel = clamped(pixelOf(map.unproject(there, map.getZoom())), this.view.store.satellite);
    this.view.reveal(this.pixel);
    this._show();
    clearTimeout(this._timer);
    this._timer = setTimeout(() => this.say(this.view.positionText(this.pixel)), 700);
  }

  /** Its position in the container of the map. */
  get point() {
    return this.view.map.latLngToContainerPoint(latLngOf(this.pixel));
  }

  _show() {
    if (!this.visible || !this.pixel) return;
    const { x, y } = this.point;
    this.element.style.transform = `translate(${x}px, ${y}px)`;
    this.view.showPosition(this.pixel);
  }
}
