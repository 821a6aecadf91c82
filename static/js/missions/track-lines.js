/**
 * Lines of the shown tracks: each whole track with a few thousand points, and its visible part at the resolution of
 * the screen. The server simplifies them; new poses are appended as they arrive.
 */

import { debounce } from "../shared/timing.js";
import { toastError } from "../shared/toast.js";
import { metresBetween, TrackPoints } from "./track-points.js";

const CALM_MS = 120;
const FEW = 5000;
const WHOLE_SHARE = 1 / 3000;
const SCREEN_SHARE = 0.7;
const FINE_ENOUGH = 1.6;
const TOO_FINE = 6;
const PAD = 0.5;
const USUAL_SHARE = 0.98;
const MOST_APPENDED = 5000;

/** Loads lines; fires `change` when points change. */
export class TrackLines extends EventTarget {
  /**
   * @param {import("./mission-store.js").MissionStore} store
   * @param {import("./mission-view.js").MissionView} view
   */
  constructor(store, view) {
    super();
    this.store = store;
    this.view = view;
    this.whole = new Map();
    this.detail = new Map();
    this._asking = new Map();
    this._aborts = new Map();
    this._fastest = null;
    this._look = debounce(() => this._details(), CALM_MS);
    view.addEventListener("move", this._look);
    view.addEventListener("ground", () => this._relay());
    store.on("missions shown", () => this.load());
    store.on("missed", ({ detail }) => this._missed(detail.key));
    store.on("poses", ({ detail }) => this._append(detail));
  }

  /** The most detailed line of a track. @returns {?TrackPoints} */
  best(key) {
    return this.detail.get(key)?.line || this.whole.get(key)?.line || null;
  }

  /** Position of a track's robot at a time, from the line with the closest points. */
  at(key, time) {
    const found = [this.detail.get(key)?.line.at(time), this.whole.get(key)?.line.at(time)].filter(Boolean);
    return found.sort((a, b) => a.gap - b.gap)[0] || null;
  }

  /** A high quantile of the speeds of the shown tracks, m/s. */
  get fastest() {
    if (this._fastest === null) {
      const timed = this.store.shown.filter(({ track }) => track.timed);
      const speeds = timed.flatMap(({ key }) => this.whole.get(key)?.line.speed.filter(Number.isFinite) || []);
      this._fastest = speeds.sort((a, b) => a - b)[Math.floor(speeds.length * USUAL_SHARE)] || 1;
    }
    return this._fastest;
  }

  /** Fetch the lines that are missing. @returns {Promise} resolved when all shown ones are loaded */
  load() {
    const wanted = this.store.shown.filter(({ track, key }) => track.poses && !this.whole.has(key));
    for (const key of this.whole.keys()) if (!this.store.track(key)) this._forget(key);
    this._look();
    return Promise.all(wanted.map((shown) => this._whole(shown)));
  }

  async _whole(shown) {
    const { track, key } = shown;
    if (this._asking.has(key)) return this._asking.get(key);
    const [south, west, north, east] = track.bounds || [0, 0, 0, 0];
    const wish = track.poses <= FEW ? 0 : metresBetween([south, west], [north, east]) * WHOLE_SHARE;
    const asked = this._ask(shown, { tolerance_m: wish.toPrecision(3) }).then((received) => {
      if (!received) return;
      const exact = received.level < 0 ? 0 : wish;
      this._keep(this.whole, shown, received, { tolerance: received.complete ? exact : Infinity, wish, box: null });
    });
    this._asking.set(key, asked);
    await asked.finally(() => this._asking.delete(key));
  }

  /** Fetch detailed lines of the view where the whole line is too coarse. */
  _details() {
    if (!this.view.ground) return;
    const box = this.view.box(PAD);
    const tolerance = this.view.metresPerPixel * SCREEN_SHARE;
    for (const shown of this.store.shown) {
      const whole = this.whole.get(shown.key);
      if (!whole) continue;
      if (!box || whole.tolerance <= tolerance * FINE_ENOUGH || !meets(box, shown.track.bounds)) {
        this._drop(shown.key);
        continue;
      }
      const known = this.detail.get(shown.key);
      const fits = known && within(this.view.box(0), known.box) && known.tolerance <= tolerance * FINE_ENOUGH;
      if (!fits || known.tolerance * TOO_FINE < tolerance) this._detail(shown, box, tolerance);
    }
  }

  async _detail(shown, box, tolerance) {
    const abort = new AbortController();
    this._aborts.get(shown.key)?.abort();
    this._aborts.set(shown.key, abort);
    const received = await this._ask(shown, { tolerance_m: tolerance.toPrecision(3), ...box }, abort.signal);
    if (!received || abort.signal.aborted) return;
    this._aborts.delete(shown.key);
    this._keep(this.detail, shown, received, { tolerance, box });
  }

  async _ask({ mission, track }, wish, signal) {
    try {
      return await this.store.server(mission.id).line(track.id, wish, signal);
    } catch (error) {
      toastError(error);
      return null;
    }
  }

  _keep(lines, { key }, received, facts) {
    const line = new TrackPoints(received, this.view.ground);
    const before = lines.get(key)?.line || this.whole.get(key)?.line;
    lines.set(key, { ...facts, line, appended: 0 });
    if (before && before.last > line.last) line.append(tail(before, line.last)); // arrived during the request
    this._changed();
  }

  _append({ key, points }) {
    for (const lines of [this.whole, this.detail]) {
      const kept = lines.get(key);
      if (!kept) continue;
      kept.line.append(points);
      kept.appended += points.length;
      if (kept.appended > MOST_APPENDED) {
        kept.appended = 0;
        if (lines === this.whole) this._again(key);
        else this._drop(key);
      }
    }
    if (!this.whole.has(key)) this.load();
    this._changed();
  }

  /** Fetch poses that no event reported. */
  async _missed(key) {
    const kept = this.whole.get(key);
    const shown = this.store.track(key);
    if (!kept || !shown) return;
    const received = await this._ask(shown, { tolerance_m: kept.wish.toPrecision(3), since: kept.line.last });
    if (received) this._append({ key, points: received.points });
  }

  /** Fetch a line again, simplified, after it has grown long. */
  async _again(key) {
    const shown = this.store.track(key);
    if (shown) await this._whole(shown);
    this._look();
  }

  _relay() {
    for (const lines of [this.whole, this.detail]) {
      for (const { line } of lines.values()) line.setGround(this.view.ground);
    }
    this._changed();
  }

  _drop(key) {
    this._aborts.get(key)?.abort();
    if (this.detail.delete(key)) this._changed();
  }

  _forget(key) {
    this._drop(key);
    this.whole.delete(key);
    this._changed();
  }

  _changed() {
    this._fastest = null;
    this.dispatchEvent(new Event("change"));
  }
}

function tail(line, after) {
  const first = line.number.findIndex((number) => number > after);
  const rows = [];
  for (let n = first; n >= 0 && n < line.length; n += 1) {
    rows.push([line.number[n], line.time[n], line.lat[n], line.lon[n], line.heading[n]]);
  }
  return rows;
}

function within(inner, outer) {
  return inner && inner.south >= outer.south && inner.north <= outer.north && inner.west >= outer.west && inner.east <= outer.east;
}

function meets(box, [south, west, north, east] = []) {
  return box.south <= north && box.north >= south && box.west <= east && box.east >= west;
}
