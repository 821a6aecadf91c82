/** Aligns the image of a floor with that of the map by pairs of clicks: the present and the wanted position of a point. */

import { h, icon } from "../../shared/dom.js";
import { t, tn } from "../../shared/i18n.js";
import { latLngOf } from "../../shared/map/coords.js";
import { toastError } from "../../shared/toast.js";

/** Minimum number of pairs for translation, rotation and scale; more improve the accuracy. */
const FEWEST = 2;

/** Takes the clicks on the image while it is active. */
export class AlignFloor {
  /** @param {Object} page store, server, view and say */
  constructor({ store, server, view, say }) {
    this.store = store;
    this.server = server;
    this.view = view;
    this.say = say;
    this.active = false;
    this.text = h("span", { role: "status" });
    this.apply = h("button", { class: "button button--primary", type: "button", "data-testid": "align-apply", onclick: () => this._apply() }, t("Apply"));
    const cancel = h("button", { class: "button button--quiet", type: "button", onclick: () => this.stop() }, t("Cancel"));
    this.bar = h("div", { class: "ed-measure-bar ed-align-bar", "data-testid": "align-bar", hidden: true }, icon("target"), this.text, this.apply, cancel);
    view.element.parentElement.append(this.bar);
    this.lines = L.layerGroup().addTo(view.map);
    store.on("floor", () => this.active && this.store.floor !== this.floor && this.stop());
  }

  /** @param {number} floor id */
  start(floor) {
    this.floor = floor;
    this.pairs = [];
    this.store.showFloor(floor);
    this.active = true;
    this.view.element.classList.add("is-measuring");
    this.view.blendFloor(true);
    this._render();
  }

  stop() {
    this.active = false;
    this.view.element.classList.remove("is-measuring");
    this.view.blendFloor(false);
    this.lines.clearLayers();
    this.bar.hidden = true;
  }

  /** A click on the image. @param {number[]} pixel */
  add(pixel) {
    const last = this.pairs.at(-1);
    if (last && !last.wanted) last.wanted = pixel;
    else this.pairs.push({ shown: pixel, wanted: null });
    this._render();
  }

  _render() {
    const whole = this.pairs.filter(({ wanted }) => wanted);
    const half = whole.length < this.pairs.length;
    const words = half ? t("Click where this spot is on the map’s image.") : t("Click on a spot of the floor’s image.");
    this.text.textContent = whole.length ? `${words} ${tn("{n} pair", "{n} pairs", whole.length)}` : words;
    this.apply.disabled = half || whole.length < FEWEST;
    this.bar.hidden = false;
    this.lines.clearLayers();
    for (const { shown, wanted } of this.pairs) {
      const point = (at) => L.circleMarker(latLngOf(at), { radius: 5, className: "ed-measure-point", interactive: false });
      this.lines.addLayer(point(shown));
      if (!wanted) continue;
      this.lines.addLayer(L.polyline([latLngOf(shown), latLngOf(wanted)], { className: "ed-measure", interactive: false }));
      this.lines.addLayer(point(wanted));
    }
    this.say(this.text.textContent);
  }

  async _apply() {
    try {
      this.store.merge(await this.server.alignFloor(this.floor, this.pairs));
      this.stop();
    } catch (error) {
      toastError(error);
    }
  }
}
