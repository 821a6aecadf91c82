/** Problems of the map, with buttons for those that can be fixed. */

import { byId, h, icon } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { sentence, toastError } from "../shared/toast.js";

/** The panel of findings. */
export class ChecksPanel {
  /**
   * @param {import("../shared/map/map-store.js").MapStore} store
   * @param {Object} server endpoints
   * @param {{view: Object, dots: Object, refresh: function(): Promise<void>}} page
   */
  constructor(store, server, page) {
    this.store = store;
    this.server = server;
    this.view = page.view;
    this.dots = page.dots;
    this.refresh = page.refresh;
    this.findings = [];
    this.fresh = null;
    byId("check-again", HTMLButtonElement).addEventListener("click", () => this.load());
    byId("tab-check").addEventListener("shown", () => this.fresh !== this.store.revision && this.load());
    byId("tab-photos").addEventListener("shown", () => this.dots.setMark([]));
    store.on("current", () => this.dots.setMark([]));
  }

  async load() {
    const button = byId("check-again", HTMLButtonElement);
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
    return h("div", { class: "ed-findings__none" }, icon("check"), h("p", {}, t("No problems found.")));
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
        h("p", { class: "ed-finding__message" }, sentence(message)),
        hint && h("p", { class: "small soft" }, sentence(hint)),
        actions));
  }

  /** Mark the photos of a finding. */
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
}
