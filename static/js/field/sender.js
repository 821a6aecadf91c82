/** Sends what waits in the outbox, one photo after the other, as soon as there is a network. */

import { metaOf } from "../shared/dom.js";
import { api, get } from "../shared/api.js";

const AGAIN_MS = 10_000;
const LOCK = "expmap-field";
const LATER = new Set(["offline", "not_ready", "too_many", "disk_full", "csrf"]);

/** Fires `state` when it begins, ends, or has to wait; `problem` says why it waits. */
export class Sender extends EventTarget {
  /** @param {import("./outbox.js").Outbox} outbox */
  constructor(outbox) {
    super();
    this.outbox = outbox;
    this.busy = false;
    this.problem = null;
  }

  /** Send now, and whenever the network comes back. */
  start() {
    addEventListener("online", () => this.send());
    document.addEventListener("visibilitychange", () => !document.hidden && this.send());
    setInterval(() => this.send(), AGAIN_MS);
    return this.send();
  }

  /** Send all that waits. Of several tabs, one sends; a tab that dies leaves the turn to the next one. */
  async send() {
    if (this.busy) return;
    this.busy = true;
    try {
      if (!navigator.locks) await this._all();
      else await navigator.locks.request(LOCK, { ifAvailable: true }, (lock) => lock && this._all());
    } finally {
      this.busy = false;
      this._tell();
    }
  }

  async _all() {
    const waiting = (await this.outbox.all()).filter(({ state }) => state === "waiting");
    this.problem = null;
    if (!waiting.length) return;
    try {
      if (!(await this._signedIn())) return;
      this._tell();
      for (const entry of waiting) await this._one(entry);
    } catch (error) {
      if (!("code" in error)) throw error;
      this.problem = error;
    }
  }

  /** The page may be one that was kept long ago: it needs the word that the server trusts today. */
  async _signedIn() {
    const { account, csrf } = await get("/session", { patient: false });
    metaOf("csrf-token").content = csrf;
    return account === this.outbox.account;
  }

  /** Send a photo; what can be better later stops here, what cannot is reported and left behind. */
  async _one({ key, map, name, photo, spot }) {
    const body = new FormData();
    body.append("file", photo, name);
    const address = `/maps/${encodeURIComponent(map)}`;
    try {
      if (spot) {
        for (const [field, value] of Object.entries(spot)) if (value !== null) body.append(field, String(value));
        await api(`${address}/photo-plan/photos`, { method: "POST", body });
        await this.outbox.change(key, { state: "added", photo: null });
        return;
      }
      const answer = await api(`${address}/localize`, { method: "POST", body, headers: { "Idempotency-Key": key } });
      await this.outbox.change(key, { state: "answered", answer, photo: null });
    } catch (error) {
      if (!("code" in error)) throw error;
      if (LATER.has(error.code) || error.status >= 500 || error.status === 401) throw error;
      await this.outbox.change(key, { state: "refused", error: [error.message, error.hint].filter(Boolean).join(": ") });
    }
  }

  _tell() {
    this.dispatchEvent(new Event("state"));
  }
}
