/** What is being done while a photo is localized, and for how long. */

import { byId, h } from "../shared/dom.js";
import { duration, t, tn } from "../shared/i18n.js";

const TICK_MS = 1000;
const SHOWN_FROM_S = 3;

export class WaitingWords {
  /**
   * @param {import("../shared/answer/query-session.js").QuerySession} session
   * @param {import("../shared/map/map-store.js").MapStore} store
   */
  constructor(session, store) {
    this.session = session;
    this.store = store;
    this.box = byId("busy-words");
    this.what = h("span", { role: "status" });
    this.seconds = h("span", { class: "number", "aria-hidden": "true" });
    this.box.append(this.what, this.seconds);
    this.begunAt = 0;
    this._timer = 0;
    session.on("busy", () => this._busy());
  }

  /** @param {?number} share of the photo that was sent; null once the server has it */
  progress(share) {
    const n = this.store.order.filter((id) => this.store.isPlaced(id)).length;
    const text = share === null ? tn("Comparing with {n} photo of the map", "Comparing with {n} photos of the map", n) : t("Sending the photo");
    if (this.what.textContent !== text) this.what.textContent = text;
  }

  _busy() {
    this.box.hidden = !this.session.busy;
    clearInterval(this._timer);
    if (!this.session.busy) return;
    this.begunAt = performance.now();
    this.seconds.textContent = "";
    this._timer = setInterval(() => this._tick(), TICK_MS);
  }

  _tick() {
    const seconds = Math.round((performance.now() - this.begunAt) / 1000);
    this.seconds.textContent = seconds >= SHOWN_FROM_S ? ` · ${duration(seconds)}` : "";
  }
}
