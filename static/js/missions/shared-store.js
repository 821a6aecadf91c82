/** A visitor's requests about a shared mission, and polling of a live one. */

import { get } from "../shared/api.js";
import { MissionStore } from "./mission-store.js";

const ASK_MS = 3000;
const SLOWEST_MS = 60000;
const PAGE = 2000;

/** State of the page of a shared mission, which is identified by its token. */
export class SharedStore extends MissionStore {
  /** @param {{id: number, token: string, symbols: import("./symbols.js").SymbolPaths[]}} page */
  constructor({ id, token, symbols }) {
    super(id, symbols);
    this._shared = endpointsOf(`/shared-missions/${encodeURIComponent(token)}`);
  }

  /** @override */
  server() {
    return this._shared;
  }
}

function endpointsOf(base) {
  return {
    state: () => get(base, { patient: false }),
    line: (track, wish, signal) => get(`${base}/tracks/${track}/line?${parameters(wish)}`, { signal }),
    profile: (track, points, signal) => get(`${base}/tracks/${track}/profile?points=${points}`, { signal }),
    objects: (wish, signal) => get(`${base}/objects?${parameters(wish)}`, { signal }),
    object: (object) => get(`${base}/objects/${encodeURIComponent(object)}`),
    drawings: () => get(`${base}/drawings`),
    coverage: () => get(`${base}/coverage`),
    photos: () => get(`${base}/photos`),
    photo: (sha256) => `/api/v1${base}/photos/${sha256}/preview`,
  };
}

/** Polls; fires `state` when the connection is lost or restored, `gone` when the link was revoked. */
export class Following extends EventTarget {
  /** @param {SharedStore} store */
  constructor(store) {
    super();
    this.store = store;
    this.connected = true;
    this._failures = 0;
    document.addEventListener("visibilitychange", () => (document.hidden ? this._pause() : this.start()));
    addEventListener("online", () => this.start());
  }

  start() {
    this._pause();
    if (document.hidden) return; // restarted when the page becomes visible
    this._timer = setTimeout(() => this._ask(), Math.min(ASK_MS * 2 ** this._failures, SLOWEST_MS));
  }

  _pause() {
    clearTimeout(this._timer);
  }

  async _ask() {
    try {
      await this._take(await this.store.server().state());
      this._failures = 0;
    } catch (error) {
      if (error.status === undefined) throw error;
      this._failures += 1;
      if (error.status === 404) {
        this.dispatchEvent(new Event("gone"));
        return;
      }
    }
    this._tell(!this._failures);
    this.start();
  }

  async _take(mission) {
    const { mission: before } = this.store;
    if (mission.cursor === before.cursor) return;
    const { objects } = await this.store.server().objects({ since: before.revision, limit: PAGE });
    this.store.refresh(mission);
    if (objects.length) this.store.setObjects(mission.id, objects);
  }

  _tell(connected) {
    if (this.connected === connected) return;
    this.connected = connected;
    this.dispatchEvent(new Event("state"));
  }
}

function parameters(wish) {
  const known = Object.entries(wish).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return new URLSearchParams(known).toString();
}
