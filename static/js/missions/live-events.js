/**
 * A live mission: the server sends what is new as events; where no stream can be had, the page polls.
 */

const ASK_MS = 3000;
const SLOWEST_MS = 30000;
const ENDED_MS = 15000;

/** Follows one mission; fires `state` with whether it hears the server, `gone` when the mission no longer exists. */
export class Live extends EventTarget {
  /**
   * @param {import("./mission-store.js").MissionStore} store
   * @param {number} id
   */
  constructor(store, id) {
    super();
    this.store = store;
    this.id = id;
    this.connected = true;
    this.failures = 0;
    this._stream = null;
    this._timer = 0;
    this._server = store.server(id);
    this._away = new AbortController();
    const { signal } = this._away;
    document.addEventListener("visibilitychange", () => (document.hidden ? this.pause() : this.start()), { signal });
    addEventListener("online", () => this.start(), { signal });
    addEventListener("pagehide", () => this.pause(), { signal });
  }

  /** Listen to what comes after the state that is known. */
  start() {
    this.pause();
    const mission = this.store.missions.get(this.id);
    // it may still be corrected, which needs no stream; but people go on with its tasks
    if (mission.ended_at && !mission.objects) return this._later(ENDED_MS);
    this._stream = this._server.events(mission.cursor, {
      changed: (received, cursor) => this._take(received, cursor),
      open: () => this._heard(),
      error: (closed) => this._lost(closed),
    });
    return null;
  }

  stop() {
    this.pause();
    this._away.abort();
  }

  /** Take everything that changed until now, without the stream. */
  async refresh() {
    try {
      const mission = await this._server.state();
      if (!this.store.missions.has(this.id)) return;
      this._heard();
      this.store.refresh(mission);
    } catch (error) {
      if (error.status === 404) this._gone();
      else this._tell(error.code !== "offline");
    }
  }

  /** Ask for nothing until `start` is called. */
  pause() {
    clearTimeout(this._timer);
    this._stream?.close();
    this._stream = null;
  }

  _take(received, cursor) {
    this._heard();
    this.store.merge(this.id, { ...received, cursor });
  }

  _heard() {
    this.failures = 0;
    this._tell(true);
  }

  /** The browser comes back by itself, as long as the server does not refuse. */
  _lost(closed) {
    this.failures += 1;
    this._tell(navigator.onLine && this.failures < 3);
    if (!closed) return;
    this.pause();
    this._later(Math.min(ASK_MS * 2 ** Math.min(this.failures - 1, 6), SLOWEST_MS));
  }

  _later(wait) {
    this._timer = setTimeout(() => this.refresh().then(() => this._away.signal.aborted || this.start()), wait);
  }

  _gone() {
    this.stop();
    this.dispatchEvent(new Event("gone"));
  }

  _tell(connected) {
    if (this.connected === connected) return;
    this.connected = connected;
    this.dispatchEvent(new Event("state"));
  }
}
