/** Guides to the spots of a map's plan one after the other and ticks them off; the ticks are kept on the device. */

import { get } from "../shared/api.js";
import { byId, h } from "../shared/dom.js";
import { metresText } from "../shared/format.js";
import { t } from "../shared/i18n.js";
import { bearingDeg, groundMetres } from "../shared/map/coords.js";
import { PlanLayer } from "../shared/map/plan-layer.js";
import { directionName, lookText, reasonText } from "../shared/plan-words.js";

const KEY = "expmap-plan-";

/** @typedef {{x_px: number, y_px: number, heading_deg: ?number, revision: number}} Target `revision`: that of the plan */

/** The part of the page about the plan; hidden without one. */
export class Guide {
  /**
   * @param {import("../shared/map/map-view.js").MapView} view
   * @param {{slug: string}} state of the map
   * @param {import("./pose.js").PhonePose} pose
   */
  constructor(view, { slug }, pose) {
    this.view = view;
    this.slug = slug;
    this.plan = null;
    this.layer = new PlanLayer(view.store).addTo(view.map);
    this.pose = pose;
    pose.addEventListener("change", () => this._lead());
    byId("plan-lead").addEventListener("click", () => this._start());
    byId("plan-done").addEventListener("click", () => this._tick(this.current, true));
  }

  /** Show the server's plan, or offline the cached one. */
  async load() {
    const { plan, replaced } = await get(`/maps/${encodeURIComponent(this.slug)}/photo-plan`, { patient: false });
    byId("plan-replaced").hidden = !replaced;
    if (replaced || !plan?.spots.length) return;
    this.plan = plan;
    const kept = JSON.parse(localStorage.getItem(KEY + this.slug) || "{}");
    /** @type {Object<number, number>} number of photos taken, by the number of the spot */
    this.taken = kept.id === plan.id ? kept.taken : {};
    this.chosen = null;
    byId("plan").hidden = false;
    this.view.focus(plan.spots.map(({ x_px: x, y_px: y }) => [x, y]));
    this._show();
  }

  /** The spot to go to: the chosen one, else the first that is not done. */
  get current() {
    const open = this.plan.spots.filter((spot) => !this._isDone(spot));
    return open.find(({ number }) => number === this.chosen) ?? open[0] ?? null;
  }

  /** Position and heading of the next photo. @returns {?Target} */
  get target() {
    const spot = this.plan && this.current;
    if (!spot) return null;
    const heading = spot.headings_deg[this.taken[spot.number] ?? 0] ?? null;
    return { x_px: spot.x_px, y_px: spot.y_px, heading_deg: heading, revision: this.plan.revision };
  }

  /** Record that a photo was taken. @param {number} number of the spot */
  photographed(number) {
    this.taken[number] = (this.taken[number] ?? 0) + 1;
    this._keep();
  }

  _wanted({ headings_deg: headings }) {
    return Math.max(headings.length, 1);
  }

  _isDone(spot) {
    return (this.taken[spot.number] ?? 0) >= this._wanted(spot);
  }

  _tick(spot, done) {
    this.taken[spot.number] = done ? this._wanted(spot) : 0;
    this._keep();
  }

  _keep() {
    localStorage.setItem(KEY + this.slug, JSON.stringify({ id: this.plan.id, taken: this.taken }));
    this._show();
  }

  _show() {
    const { spots } = this.plan;
    const done = new Set(spots.filter((spot) => this._isDone(spot)).map(({ number }) => number));
    const spot = this.current;
    this.layer.show(this.plan, { cells: false, current: spot?.number ?? null, done });
    byId("plan-title").textContent = spot ? t("Spot {n} of {all}", { n: spot.number, all: spots.length }) : t("All spots are done.");
    byId("plan-count").textContent = t("{n} of {all} done", { n: done.size, all: spots.length });
    byId("plan-count").dataset.done = String(done.size);
    byId("plan-next").hidden = !spot;
    if (spot) {
      const heading = this.target.heading_deg;
      const which = spot.headings_deg.length > 1 ? ` (${(this.taken[spot.number] ?? 0) + 1}/${spot.headings_deg.length})` : "";
      byId("plan-look").textContent = heading === null ? lookText([]) : t("Look {directions}", { directions: directionName(heading) }) + which;
      byId("plan-reason").textContent = reasonText(spot.reason);
      this.view.reveal([spot.x_px, spot.y_px], { margin: 60 });
    }
    byId("plan-spots").replaceChildren(...spots.map((one) => this._row(one)));
    this._lead();
  }

  _row(spot) {
    const tick = h("input", { type: "checkbox", checked: this._isDone(spot), "aria-label": t("Spot {n} is done", { n: spot.number }), "data-testid": "plan-tick" });
    tick.addEventListener("change", () => this._tick(spot, tick.checked));
    const go = () => {
      this.chosen = spot.number;
      this._show();
    };
    return h("li", { class: "fi-spot" }, tick, h("button", { class: "fi-spot__go", type: "button", onclick: go },
      h("strong", {}, spot.number), h("span", {}, lookText(spot.headings_deg))));
  }

  async _start() {
    await this.pose.start();
    this._lead();
  }

  /** Show distance and direction, relative to the compass heading, or to north without a compass. */
  _lead() {
    const spot = this.plan && this.current;
    if (!spot) return;
    const known = spot.lat !== null;
    const { position, heading, problem, watching } = this.pose;
    byId("plan-lead").hidden = watching || !known;
    byId("plan-way").hidden = !watching && !problem;
    byId("plan-arrow").classList.toggle("is-unknown", !position);
    if (!position) {
      byId("plan-distance").textContent = problem ? t("The position of this device is not known: {reason}", { reason: problem }) : t("Looking for your position …");
      return;
    }
    const from = [position.lat, position.lon];
    const bearing = bearingDeg(from, [spot.lat, spot.lon]);
    const distance = groundMetres(from, [spot.lat, spot.lon]);
    byId("plan-arrow").style.transform = `rotate(${Math.round(bearing - (heading ?? 0))}deg)`;
    byId("plan-distance").textContent = distance <= Math.max(position.accuracy, 5) ? t("You are there.")
      : t("{distance} to the {direction}", { distance: `${metresText(Math.round(distance))} m`, direction: directionName(bearing) });
    byId("plan-compass").hidden = heading !== null;
  }
}
