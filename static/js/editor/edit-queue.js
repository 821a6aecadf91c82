/**
 * Queue of edits to be sent to the server: shown at once, sent one after another, kept while offline.
 *
 * Every edit is sent with the newest revision that its author had seen. Earlier edits of the same photo by the
 * author are no conflict; an edit by someone else is one, and then nothing is overwritten.
 */

import { tn } from "../shared/i18n.js";
import { pendingKey } from "../shared/map/map-store.js";

const RETRY_MS = [1000, 2000, 4000, 8000, 15000];
/** Turns come in many small steps, which are collected for this time. */
const COLLECT_MS = 450;

/** @typedef {Api["NumberedChange"] & {removed?: boolean}} Change */

/**
 * @typedef {Object} Item
 * @property {"edit"|"remove"|"undo"|"redo"} action
 * @property {string} kind for the label of the undo button
 * @property {?string} placement
 * @property {Change[]} changes fields by photo
 * @property {number} seen revision that the author had seen
 * @property {number} notBefore earliest time to send it, in milliseconds of `performance.now()`
 * @property {boolean} [uncertain] whether a response was lost
 */

/**
 * The queue. Fires `change` when its length or state changes, `saved` with the item and the answer, and `refused`
 * with `message` and `hint` when an edit was rejected.
 */
export class EditQueue extends EventTarget {
  /**
   * @param {import("../shared/map/map-store.js").MapStore} store
   * @param {Object} server `edit, remove, undo, redo` of endpoints.js
   * @param {function(): Promise<void>} refresh fetches all changes from the server
   */
  constructor(store, server, refresh) {
    super();
    this.store = store;
    this.server = server;
    this.refresh = refresh;
    this.items = [];
    this.failures = 0;
    this.offline = false;
    this._own = new Map();
    this._stale = false;
    this._busy = false;
    this._timer = 0;
    addEventListener("online", () => this._wake());
    addEventListener("beforeunload", (event) => this.items.length && event.preventDefault());
  }

  /** Number of edits that are not saved yet. */
  get waiting() {
    return this.items.length;
  }

  /** Change positions or headings. @param {string} kind @param {Change[]} changes */
  edit(kind, changes) {
    const { placement, revision } = this.store;
    const last = this.items.at(-1);
    const notBefore = kind === "turn" ? performance.now() + COLLECT_MS : 0;
    if (last && last !== this._sending && last.kind === kind && kind === "turn" && sameIds(last.changes, changes)) {
      Object.assign(last, { changes, notBefore });
    } else {
      this._add({ action: "edit", kind, placement, changes, seen: revision, notBefore, uncertain: false });
    }
    this._show();
    this._wake();
  }

  /** Remove photos from the map. @param {number[]} ids */
  remove(ids) {
    const changes = ids.map((id) => ({ id, removed: true }));
    this._add({ action: "remove", kind: "remove", placement: null, changes, seen: this.store.revision, notBefore: 0 });
    this._show();
    this._wake();
  }

  /** @param {"undo"|"redo"} action */
  step(action) {
    this.items.forEach((item) => (item.notBefore = 0));
    this._add({ action, kind: action, placement: null, changes: [], seen: this.store.revision, notBefore: 0 });
    this._wake();
  }

  _add(item) {
    this.items.push(item);
    this.dispatchEvent(new Event("change"));
  }

  /** Overlay the server's state with all unsaved edits. */
  _show() {
    const pending = new Map();
    for (const item of this.items) {
      for (const { id, ...fields } of item.changes) {
        for (const [name, value] of Object.entries(fields)) {
          const key = pendingKey(name === "x_px" || name === "y_px" ? item.placement : null, id);
          pending.set(key, { ...pending.get(key), [name]: value });
        }
      }
    }
    this.store.setPending(pending);
  }

  _wake() {
    clearTimeout(this._timer);
    if (!this._busy) this._send();
  }

  async _send() {
    const item = this.items[0];
    if (!item) return;
    const wait = item.notBefore - performance.now();
    if (wait > 0) {
      this._timer = setTimeout(() => this._send(), wait);
      return;
    }
    this._busy = true;
    this._sending = item;
    let pause = 0;
    try {
      await this._one(item);
      this.failures = 0;
      this.offline = false;
    } catch (error) {
      pause = await this._failed(item, error);
    }
    this._sending = null;
    this._busy = false;
    this.dispatchEvent(new Event("change"));
    if (this.items.length) this._timer = setTimeout(() => this._send(), pause);
  }

  async _one(item) {
    if (item.uncertain || this._stale) {
      const before = this.store.revision;
      await this.refresh();
      this._stale = false;
      if (item.uncertain && this._arrived(item, before)) return this._done(item);
    }
    const answer = await this._call(item);
    await this._take(item, answer);
    this._done(item);
  }

  _call(item) {
    const { action, kind, placement, changes } = item;
    const foreign = changes.some(({ id }) => this._changedByOthers(id, item.seen));
    const seen = foreign ? item.seen : this.store.revision; // so that the server refuses the edit
    if (action === "edit") return this.server.edit({ seen, kind, changes, ...(placement && { placement }) });
    if (action === "remove") return this.server.remove({ seen, ids: changes.map(({ id }) => id) });
    return this.server[action]();
  }

  /** Merge a response; a gap in the revisions means that someone else made changes meanwhile. */
  async _take(item, answer) {
    const gap = answer.revision > this.store.revision + 1;
    if (answer.revision !== null) {
      for (const { id } of [...item.changes, ...answer.photos]) this._own.set(id, answer.revision);
      if (!gap) this.store.revision = Math.max(this.store.revision, answer.revision);
    }
    this.items = this.items.filter((other) => other !== item);
    this._show();
    this.store.merge(answer);
    this.dispatchEvent(new CustomEvent("saved", { detail: { item, answer } }));
    this._stale = gap;
    if (gap) await this.refresh();
    this._stale = false;
  }

  _done(item) {
    this.items = this.items.filter((other) => other !== item);
    this._show();
  }

  _changedByOthers(id, seen) {
    const photo = this.store.photos.get(id);
    return Boolean(photo) && photo.revision > seen && this._own.get(id) !== photo.revision;
  }

  /** Whether an edit whose response was lost has been saved. */
  _arrived(item, before) {
    if (item.action === "undo" || item.action === "redo") return this.store.revision > before;
    return item.changes.every(({ id, removed, ...fields }) => {
      const photo = this.store.photos.get(id);
      if (removed || !photo) return Boolean(removed) && !photo;
      const place = item.placement ? this.store.placements.get(item.placement)?.get(id) : [photo.x_px, photo.y_px];
      const there = { x_px: place?.[0] ?? null, y_px: place?.[1] ?? null, heading_deg: photo.heading_deg, taken_at: photo.taken_at, floor: photo.floor };
      return Object.entries(fields).every(([name, value]) => there[name] === value);
    });
  }

  /** @returns {Promise<number>} milliseconds to wait before the next attempt */
  async _failed(item, error) {
    if (!this.items.includes(item)) return 0; // it is saved; only fetching other changes failed
    const later = error.status === 0 || error.status >= 500 || error.status === 429 || error.status === 401;
    if (later) {
      item.uncertain = error.status === 0 || error.status >= 500;
      this.offline = error.status === 0;
      this.failures += 1;
      if (error.status !== 0 && this.failures === 1) this._refused(error);
      return RETRY_MS[Math.min(this.failures, RETRY_MS.length) - 1];
    }
    const conflict = error.status === 409 || error.status === 412;
    this._done(item);
    await this.refresh().catch(() => {});
    if (conflict) this._conflict(item, error.message, error.hint);
    else this._refused(error);
    return 0;
  }

  /** Discard an edit and later ones of the same photos. */
  _conflict(item, message, hint = null) {
    const ids = new Set(item.changes.map(({ id }) => id));
    const lost = this.items.filter((other) => other === item || other.changes.some(({ id }) => ids.has(id)));
    this.items = this.items.filter((other) => !lost.includes(other));
    this._show();
    const count = Math.max(lost.length, 1);
    const explanation = hint || tn("Your change was not saved: the photo is shown as it is now", "{n} of your changes were not saved: the photos are shown as they are now", count);
    this.dispatchEvent(new CustomEvent("refused", { detail: { message, hint: explanation } }));
  }

  _refused(error) {
    this.dispatchEvent(new CustomEvent("refused", { detail: { message: error.message, hint: error.hint } }));
  }
}

function sameIds(a, b) {
  return a.length === b.length && a.every(({ id }, n) => id === b[n].id);
}
