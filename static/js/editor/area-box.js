/** A rectangle on the image: its corners are dragged, or moved by the arrow keys. */

import { h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { latLngOf, pixelOf } from "../shared/map/coords.js";

const LEFT = 0;
const TOP = 1;
const RIGHT = 2;
const BOTTOM = 3;
const CORNERS = [[LEFT, TOP], [RIGHT, TOP], [RIGHT, BOTTOM], [LEFT, BOTTOM]];
/** @type {Object<string, [number, number]>} */
const STEPS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const STEP_PX = 8;
/** Initial margin on each side, as a fraction of the view: the dialog covers a part of it. */
const OF_VIEW = 0.18;

/** Calls `changed` whenever it changes; `sides` are left, top, right and bottom, map pixels. */
export class AreaBox {
  /**
   * @param {import("../shared/map/map-view.js").MapView} view
   * @param {function(): void} changed
   */
  constructor(view, changed) {
    this.view = view;
    this.changed = changed;
    this.sides = [0, 0, 0, 0];
    this.shape = L.rectangle(L.latLngBounds([0, 0], [0, 0]), { className: "ed-area", interactive: false });
    const names = [t("Top left corner of the area"), t("Top right corner of the area"), t("Bottom right corner of the area"), t("Bottom left corner of the area")];
    this.handles = CORNERS.map(([x, y], n) => this._handle(x, y, names[n]));
    this.layer = L.layerGroup([this.shape, ...this.handles]).addTo(view.map);
    this.ofView();
  }

  /** Set it to most of the visible part of the image. */
  ofView() {
    const { width, height } = this.view.store.satellite;
    const [left, top, right, bottom] = this.view.inView(OF_VIEW);
    const inside = [Math.max(left, 0), Math.max(top, 0), Math.min(right, width), Math.min(bottom, height)];
    this._set(inside[LEFT] < inside[RIGHT] && inside[TOP] < inside[BOTTOM] ? inside : [0, 0, width, height]);
  }

  remove() {
    this.layer.remove();
  }

  _handle(x, y, name) {
    const button = h("button", { class: "ed-area__corner", type: "button", "aria-label": name });
    const icon = L.divIcon({ html: button, className: "ed-area__handle", iconSize: [28, 28], iconAnchor: [14, 14] });
    const handle = L.marker([0, 0], { icon, draggable: true, keyboard: false });
    handle.on("drag", () => this._move(x, y, pixelOf(handle.getLatLng())));
    button.addEventListener("keydown", (event) => {
      const step = STEPS[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      const point = this.view.map.latLngToContainerPoint(handle.getLatLng()).add(L.point(step).multiplyBy(STEP_PX));
      this._move(x, y, pixelOf(this.view.map.containerPointToLatLng(point)));
    });
    return handle;
  }

  /** Move a corner; it cannot pass the opposite one. */
  _move(x, y, [toX, toY]) {
    const sides = [...this.sides];
    [sides[x], sides[y]] = [toX, toY];
    this._set(sides[LEFT] < sides[RIGHT] && sides[TOP] < sides[BOTTOM] ? sides : this.sides);
  }

  _set(sides) {
    this.sides = sides;
    this.shape.setBounds(L.latLngBounds(latLngOf([sides[LEFT], sides[TOP]]), latLngOf([sides[RIGHT], sides[BOTTOM]])));
    CORNERS.forEach(([x, y], n) => this.handles[n].setLatLng(latLngOf([sides[x], sides[y]])));
    this.changed();
  }
}
