/**
 * A live mission: the server sends changes as events; if no stream is possible, the page polls.
 */

const ASK_MS = 3000;
const SLOWEST_MS = 30000;
const ENDED_MS = 15000;

/** Follows one mission; fires `state` when the connection is lost or restored, `gone` when the mission no longer exists. */
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
    this._following = false;
    this._stream = null;
    this._timer = 0;
    this._turn = 0; // incremented when opened or closed, to recognise late responses
    this._server = store.server(id);
    this._away = new AbortController();
    const { signal } = this._away;
    document.addEventListener("visibilitychange", () => (document.hidden ? this._close() : this._open()), { signal });
    addEventListener("online", () => this._open(), { signal });
    addEventListener("pagehide", () => this._close(), { signal });
  }

  /** Listen for changes after the known state. */
  start() {
    this._following = true;
    this._open();
  }

  /** Send no requests until `start` is called. */
  pause() {
    this._following = false;
    this._close();
  }

  _open() {
    this._close();
    if (!this._following) return;
    const mission = this.store.missions.get(this.id);
    // after its end only rare corrections come, for which polling suffices, unless it has objects to work on
    if (mission.ended_at && !mission.objects) {
      this._later(ENDED_MS);
      return;
    }
    this._stream = this._server.events(mission.cursor, {
      changed: (received, cursor) => this._take(received, cursor),
      open: () => this._heard(),
      error: (closed) => this._lost(closed),
    });
  }

  stop() {
    this.pause();
    this._away.abort();
  }

  /** Fetch all changes until now, without the stream. */
  async refresh() {
    const turn = this._turn;
    try {
      const mission = await this._server.state();
      if (!this.store.missions.has(this.id)) return;
      this._heard();
      this.store.refresh(mission);
    } catch (error) {
      if (error.status === 404 && turn === this._turn) this._gone();
      else this._tell(error.code !== "offline");
    }
  }

  _close() {
    this._turn += 1;
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

  /** The browser reconnects by itself unless the server refused, which closes the stream. */
  _lost(closed) {
    this.failures += 1;
    this._tell(navigator.onLine && this.failures < 3);
    if (!closed) return;
    this._close();
    this._later(Math.min(ASK_MS * 2 ** Math.min(this.failures - 1, 6), SLOWEST_MS));
  }

  _later(wait) {
    const turn = this._turn;
    this._timer = setTimeout(async () => {
      await this.refresh();
      if (turn === this._turn) this._open();
    }, wait);
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
