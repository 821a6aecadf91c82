/** Arrows from the given position of a point to the fitted one. */

import { t } from "../i18n.js";

const READABLE_PX = 64;
const FACTORS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
const INVISIBLE_PX = 0.02;
const PANE = "arrows";

/** Arrows on one map; small residuals are enlarged by a common factor, which is shown. */
export class Arrows {
  /** @param {L.Map} map */
  constructor(map) {
    this.map = map;
    this.pairs = [];
    this.group = L.layerGroup().addTo(map);
    // above the markers, but transparent to the mouse
    Object.assign(map.createPane(PANE).style, { zIndex: 620, pointerEvents: "none" });
    this.box = L.DomUtil.create("div", "sat-legend");
    this.box.hidden = true;
    const legend = new L.Control({ position: "bottomleft" });
    legend.onAdd = () => this.box;
    legend.addTo(map);
    map.on("zoomend", () => this._draw());
  }

  /** @param {Array<[L.LatLng, L.LatLng]>} pairs from and to */
  show(pairs) {
    this.pairs = pairs;
    this._draw();
  }

  _draw() {
    this.group.clearLayers();
    // by projection: layer points are rounded to whole pixels
    const zoom = this.map.getZoom();
    const arrows = this.pairs.map(([from, to]) => ({
      start: this.map.latLngToLayerPoint(from),
      step: this.map.project(to, zoom).subtract(this.map.project(from, zoom)),
    }));
    const longest = Math.max(0, ...arrows.map(({ step }) => Math.hypot(step.x, step.y)));
    this.box.hidden = longest < INVISIBLE_PX;
    if (this.box.hidden) return;
    const factor = FACTORS.find((f) => f * longest >= READABLE_PX) || FACTORS.at(-1);
    this.box.textContent = factor === 1 ? t("Residuals") : t("Residuals, drawn {factor} times longer", { factor });
    for (const { start, step } of arrows) this._arrow(start, step.multiplyBy(factor));
  }

  _arrow(start, step) {
    const length = Math.hypot(step.x, step.y);
    if (length < 2) return;
    const end = start.add(step);
    const side = (turn) => {
      const angle = Math.atan2(step.y, step.x) + turn;
      return end.subtract(L.point(Math.cos(angle), Math.sin(angle)).multiplyBy(Math.min(12, length / 2)));
    };
    const at = (point) => this.map.layerPointToLatLng(point);
    const options = { pane: PANE, className: "sat-arrow", interactive: false };
    L.polyline([[at(start), at(end)], [at(side(0.45)), at(end), at(side(-0.45))]], options).addTo(this.group);
  }
}
