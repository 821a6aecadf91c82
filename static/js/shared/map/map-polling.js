/** Polls the server for changes of other people and for jobs, every second while the page is visible. */

const VISIBLE_MS = 1000;
const HIDDEN_MS = 30000;
const SLOWEST_MS = 20000;

/** Polls; fires `state` when the connection is lost or is back. */
export class MapPolling extends EventTarget {
  /**
   * @param {import("./map-store.js").MapStore} store
   * @param {function(number): Promise<Object>} changesSince
   */
  constructor(store, changesSince) {
    super();
    this.store = store;
    this.changesSince = changesSince;
    this.failures = 0;
    this._timer = 0;
    this._asking = null;
    document.addEventListener("visibilitychange", () => document.hidden || this.soon());
    addEventListener("online", () => this.soon());
  }

  get connected() {
    return this.failures < 2;
  }

  start() {
    this._timer = setTimeout(() => this._turn(), VISIBLE_MS);
  }

  /** Poll now instead of at the next interval. */
  soon() {
    clearTimeout(this._timer);
    this._turn();
  }

  /** Fetch all changes until now; the answer to a pending request may be too old, so another one follows. */
  async refresh() {
    if (this._asking) await this._asking.catch(() => {});
    await this._ask();
  }

  _ask() {
    if (!this._asking) {
      this._asking = this._take().finally(() => (this._asking = null));
    }
    return this._asking;
  }

  async _take() {
    const since = this.store.revision;
    const changes = await this.changesSince(since);
    this.store.merge(changes.revision < this.store.revision ? { photos: changes.photos } : changes);
    this.store.revision = Math.max(this.store.revision, changes.revision);
    if (changes.jobs) this.store.setJobs(changes.jobs);
    if (changes.people) this.store.setPeople(changes.people);
  }

  async _turn() {
    clearTimeout(this._timer);
    try {
      await this._ask();
      this._count(0);
    } catch {
      this._count(this.failures + 1);
    }
    const slow = Math.min(VISIBLE_MS * 2 ** this.failures, SLOWEST_MS);
    clearTimeout(this._timer);
    this._timer = setTimeout(() => this._turn(), document.hidden ? HIDDEN_MS : slow);
  }

  _count(failures) {
    const before = this.connected;
    this.failures = failures;
    if (before !== this.connected) this.dispatchEvent(new Event("state"));
  }
}
