/** A rectangle on a slippy map, with corners to drag or to move by the arrow keys. */

import { t } from "../shared/i18n.js";
import { pin } from "../shared/map/pin.js";
import { eastOf } from "./tile-map.js";

const CORNERS = [["north", "west"], ["north", "east"], ["south", "east"], ["south", "west"]];
const STEP_PX = 8;

/** Calls `changed` with `{north, south, west, east}` whenever it is changed by hand. */
export class Rectangle {
  /**
   * @param {L.Map} map
   * @param {function(Object): void} changed
   */
  constructor(map, changed) {
    this.map = map;
    this.changed = changed;
    this.box = null;
    this.shape = L.rectangle([[0, 0], [0, 0]], { className: "sat-area", interactive: false });
    this.handles = CORNERS.map((edges) => this._handle(edges));
  }

  /** Show a rectangle; null hides it. */
  show(box) {
    this.box = box;
    for (const layer of [this.shape, ...this.handles]) {
      if (box) layer.addTo(this.map);
      else layer.remove();
    }
    if (!box) return;
    const { north, south, west } = box;
    const east = eastOf(box);
    this.shape.setBounds([[south, west], [north, east]]);
    const at = { north, south, west, east };
    CORNERS.forEach(([lat, lon], n) => this.handles[n].setLatLng([at[lat], at[lon]]));
  }

  /** Set it to a proposed area. */
  propose({ north, south, west, east }) {
    this._set({ north, south, west, east });
  }

  /** Set it to most of the view. */
  ofView() {
    const view = this.map.getBounds().pad(-0.12);
    this._set({ north: view.getNorth(), south: view.getSouth(), west: view.getWest(), east: view.getEast() });
  }

  _handle(edges) {
    const names = { "north-west": t("north-west"), "north-east": t("north-east"), "south-west": t("south-west"), "south-east": t("south-east") };
    const title = t("Corner in the {where}", { where: names[edges.join("-")] });
    const handle = L.marker([0, 0], { icon: pin("", "sat-pin--corner"), draggable: true, title, alt: title });
    handle.on("drag", () => this._move(edges, handle.getLatLng()));
    handle.on("add", () => {
      handle.getElement().addEventListener("keydown", (event) => this._key(event, edges, handle));
    });
    return handle;
  }

  _key(event, edges, handle) {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const step = steps[event.key];
    if (!step) return;
    event.preventDefault();
    event.stopPropagation();
    const point = this.map.latLngToContainerPoint(handle.getLatLng()).add(L.point(step).multiplyBy(STEP_PX));
    this._move(edges, this.map.containerPointToLatLng(point));
  }

  /** Move a corner; it cannot pass the opposite one. */
  _move([lat, lon], { lat: north, lng: east }) {
    const box = { ...this.box, [lat]: north, [lon]: east };
    if (box.north > box.south && box.west < box.east) this._set(box);
    else this.show(this.box);
  }

  _set(box) {
    const tidy = Object.fromEntries(Object.entries(box).map(([edge, value]) => [edge, Number(value.toFixed(7))]));
    this.show(tidy);
    this.changed(tidy);
  }
}
