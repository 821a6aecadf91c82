/** What is wrong with the map, with a button for what can be put right, and which places look alike. */

import { h, icon } from "../dom.js";
import { t, tn } from "../i18n.js";
import { toastError } from "../toast.js";
import { byId } from "./page.js";

const HEALTH = {
  confusable: { colour: "#e8503a", words: () => t("looks like another place") },
  lonely: { colour: "#8a5cf6", words: () => t("alone: nothing near confirms it") },
  "one-direction": { colour: "#f2a900", words: () => t("seen in one direction only") },
  good: { colour: "#2fa866", words: () => t("found again well") },
};

/** The panel of findings, and the colours of the dots. */
export class Check {
  /**
   * @param {import("./store.js").Store} store
   * @param {Object} server endpoints
   * @param {{view: Object, dots: Object, refresh: function(): Promise<void>}} page
   */
  constructor(store, server, page) {
    Object.assign(this, { store, server, ...page });
    this.findings = [];
    this.fresh = null;
    byId("check-again").addEventListener("click", () => this.load());
    byId("tab-check").addEventListener("shown", () => this.fresh !== this.store.revision && this.load());
    byId("tab-photos").addEventListener("shown", () => this.dots.setMark([]));
    byId("health-toggle").addEventListener("change", (event) => this._health(event.target));
    store.on("current", () => this.dots.setMark([]));
  }

  async load() {
    const button = byId("check-again");
    button.disabled = true;
    try {
      const { findings } = await this.server.findings();
      this.findings = findings;
      this.fresh = this.store.revision;
      this.render();
    } catch (error) {
      toastError(error);
    }
    button.disabled = false;
  }

  render() {
    const box = byId("findings");
    const count = byId("check-count");
    count.hidden = !this.findings.length;
    count.textContent = String(this.findings.length);
    const rows = this.findings.map((finding) => this._finding(finding));
    box.replaceChildren(...(rows.length ? rows : [this._nothing()]));
  }

  _nothing() {
    return h("div", { class: "ed-findings__none" }, icon("check"), h("p", {}, t("Nothing is wrong with this map.")));
  }

  _finding(finding) {
    const { code, severity, message, hint, ids = [], fixes } = finding;
    const known = ids.filter((id) => this.store.photos.has(id));
    const actions = h("div", { class: "row" });
    if (known.length) {
      const words = known.length === 1 ? this.store.photos.get(known[0]).name : tn("Show {n} photo", "Show {n} photos", known.length);
      actions.append(h("button", { class: "button button--quiet", type: "button", onclick: () => this._show(known) }, icon("search"), words));
    }
    for (const fix of fixes || []) {
      if (!this.store.canEdit) continue;
      actions.append(h("button", { class: "button", type: "button", onclick: (event) => this._fix(event.currentTarget, fix, ids) }, fix.label));
    }
    return h("article", { class: `ed-finding ed-finding--${severity}`, dataset: { code } },
      icon(severity === "error" ? "warning" : "info"),
      h("div", { class: "stack stack--tight" },
        h("p", { class: "ed-finding__message" }, message),
        hint && h("p", { class: "small soft" }, hint),
        actions));
  }

  /** Point at the photos of a finding. */
  _show(ids) {
    this.store.setCurrent(ids[0]);
    const pixels = ids.map((id) => this.store.position(id)).filter(Boolean);
    this.view.focus(pixels);
    this.dots.setMark(pixels);
  }

  async _fix(button, fix, ids) {
    button.disabled = true;
    try {
      await this.server.fix(fix.code, ids);
      await this.refresh();
      await this.load();
    } catch (error) {
      toastError(error);
      button.disabled = false;
    }
  }

  async _health(toggle) {
    byId("health-legend").hidden = true;
    this.dots.setColours(null);
    if (!toggle.checked) return;
    toggle.disabled = true;
    try {
      this._colour(await this.server.health());
    } catch (error) {
      toggle.checked = false;
      toastError(error);
    }
    toggle.disabled = false;
  }

  /** @param {{photos: Array<{id: number, state: string}>}} health */
  _colour({ photos }) {
    const counts = new Map();
    const colours = new Map();
    for (const { id, state } of photos) {
      counts.set(state, (counts.get(state) || 0) + 1);
      if (HEALTH[state]) colours.set(id, HEALTH[state].colour);
    }
    this.dots.setColours(colours);
    const rows = Object.entries(HEALTH).filter(([state]) => counts.has(state)).map(([state, { colour, words }]) => {
      const dot = h("span", { class: "ed-legend__dot" });
      dot.style.background = colour;
      return h("li", {}, dot, words(), h("span", { class: "soft" }, String(counts.get(state))));
    });
    const legend = byId("health-legend");
    legend.replaceChildren(...rows);
    legend.hidden = false;
  }
}
