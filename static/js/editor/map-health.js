/** Colours of the dots for places that look alike, are isolated, or were seen in one direction only. */

import { byId, h } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";

const STATES = {
  confusable: { colour: "#e8503a", words: () => t("looks like another place") },
  lonely: { colour: "#8a5cf6", words: () => t("isolated: no photo nearby confirms it") },
  "one-direction": { colour: "#f2a900", words: () => t("seen in one direction only") },
  good: { colour: "#2fa866", words: () => t("recognised reliably") },
};

/** The switch for the colours and their legend. */
export class MapHealth {
  /** @param {Object} page store, server, refresh and dots */
  constructor({ store, server, refresh, dots }) {
    this.store = store;
    this.server = server;
    this.refresh = refresh;
    this.dots = dots;
    this.toggle = byId("health-toggle", HTMLInputElement);
    this.job = null;
    this.toggle.addEventListener("change", () => this._switch());
    store.on("jobs", () => this._watch());
  }

  async _switch() {
    this.job = null;
    if (this.toggle.checked) await this._ask("health");
    else this._clear();
  }

  /** @param {"health"|"findHealth"} question */
  async _ask(question) {
    try {
      const health = await this.server[question]();
      if (!this.toggle.checked) return;
      this.job = health.job;
      if (health.revision === null && health.job === null) await this._ask("findHealth"); // first time
      else this._show(health);
    } catch (error) {
      this.toggle.checked = false;
      this._clear();
      toastError(error);
    }
  }

  /** Reload the result when its job has ended. */
  _watch() {
    const job = this.store.jobs.find(({ id }) => id === this.job);
    if (!job || job.state === "queued" || job.state === "running") return;
    this.job = null;
    if (job.state === "done") this._ask("health");
  }

  _clear() {
    byId("health-legend").hidden = true;
    this.dots.setColours(null);
  }

  _show({ photos, revision, current, job }) {
    const oneWay = photos.filter(({ state }) => state === "one-direction").length;
    // If most places are so, the map is of a walk in one direction, and they are not weaker than the others.
    const isWalk = oneWay > photos.length / 2;
    const shown = (state) => (isWalk && state === "one-direction" ? "good" : state);
    const counts = new Map();
    for (const { state } of photos) counts.set(shown(state), (counts.get(shown(state)) || 0) + 1);
    const rows = Object.entries(STATES).filter(([state]) => counts.has(state)).map(([state, { colour, words }]) => {
      const dot = h("span", { class: "ed-legend__dot" });
      dot.style.background = colour;
      return h("li", {}, dot, words(), h("span", { class: "soft" }, String(counts.get(state))));
    });
    if (photos.length) {
      const unknown = this.store.order.filter((id) => this.store.isPlaced(id)).length - photos.length;
      if (unknown > 0) rows.push(h("li", { class: "soft" }, tn("{n} photo was not evaluated", "{n} photos were not evaluated", unknown)));
    }
    if (isWalk) rows.push(h("li", { class: "soft" }, t("Most places were photographed in one direction only: a walk back would help.")));
    if (job !== null) rows.push(h("li", {}, t("This is being computed; it takes a few minutes.")));
    else if (revision !== null && !current) rows.push(this._again());
    this.dots.setColours(photos.length === 0 ? null : new Map(photos.filter(({ state }) => STATES[state]).map(({ id, state }) => [id, STATES[shown(state)].colour])));
    const legend = byId("health-legend");
    legend.replaceChildren(...rows);
    legend.hidden = false;
  }

  _again() {
    const find = () => this._ask("findHealth").then(() => this.refresh()).catch(toastError);
    return h("li", {}, t("The map has changed since."),
      h("button", { class: "button", type: "button", onclick: find }, t("Run again")));
  }
}
