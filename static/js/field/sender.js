/** Sends the photos of the outbox one after the other, as soon as there is a network. */

import { metaOf } from "../shared/dom.js";
import { api, get } from "../shared/api.js";

const AGAIN_MS = 10_000;
const LOCK = "expmap-field";
const LATER = new Set(["offline", "not_ready", "too_many", "disk_full", "csrf"]);

/** Fires `state` when sending begins or ends; `problem` is the error that stopped it. */
export class Sender extends EventTarget {
  /** @param {import("./outbox.js").Outbox} outbox */
  constructor(outbox) {
    super();
    this.outbox = outbox;
    this.busy = false;
    this.problem = null;
  }

  /** Send now, every 10 s, and whenever the network or the page comes back. */
  start() {
    addEventListener("online", () => this.send());
    document.addEventListener("visibilitychange", () => !document.hidden && this.send());
    setInterval(() => this.send(), AGAIN_MS);
    return this.send();
  }

  /** Send all waiting photos. A lock lets only one tab send; it is released when the tab is closed. */
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

  /** Check the account and renew the CSRF token: the page may come from the cache and be old. */
  async _signedIn() {
    const { account, csrf } = await get("/session", { patient: false });
    metaOf("csrf-token").content = csrf;
    return account === this.outbox.account;
  }

  /** Send a photo. Temporary errors are thrown, which stops sending; permanent ones go into the entry. */
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
