/** State of a mission's page: missions, tracks, objects; what is shown, how, and at which moment. */

import { endpointsOf } from "./endpoints.js";
import { Symbols } from "./symbols.js";

/** If the total span exceeds this many times the longest mission, all are aligned to begin together. */
const APART = 3;
const BEST_FIRST = ["fused", "gps", "odometry", "visual", "manual"];

/** State of the page; fires an event named after what changed. */
export class MissionStore extends EventTarget {
  /**
   * @param {number} id of the mission that the page is about
   * @param {import("./symbols.js").SymbolPaths[]} symbols
   */
  constructor(id, symbols) {
    super();
    this.id = id;
    this.missions = new Map();
    this.ticked = new Map(); // tracks that are shown or hidden here, whatever is set for all
    this.mode = "source";
    this.moment = null;
    this.objects = new Map();
    this.fixes = [];
    this.matching = null;
    this.chosen = null;
    this.trail = [];
    this.drawn = null;
    this.symbols = new Symbols(symbols);
    this._servers = new Map();
  }

  /** Notify listeners. */
  emit(name, detail = null) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  /** Call a function on some events. */
  on(names, run) {
    for (const name of names.split(" ")) this.addEventListener(name, run);
  }

  /** The mission of the page. */
  get mission() {
    return this.missions.get(this.id) || null;
  }

  server(id) {
    if (!this._servers.has(id)) this._servers.set(id, endpointsOf(id));
    return this._servers.get(id);
  }

  /** All tracks of all missions: `{mission, track, key}`, those of the page's own mission first. */
  get tracks() {
    return [...this.missions.values()].flatMap((mission) =>
      [...mission.tracks]
        .sort((a, b) => BEST_FIRST.indexOf(a.source) - BEST_FIRST.indexOf(b.source) || a.id - b.id)
        .map((track) => ({ mission, track, key: keyOf(mission.id, track.id) })));
  }

  /** The tracks that are shown. */
  get shown() {
    return this.tracks.filter((one) => this.isShown(one));
  }

  /** Whether a track is shown: as ticked on this page, else as set for all. */
  isShown({ track, key }) {
    return this.ticked.get(key) ?? !track.look?.hidden;
  }

  track(key) {
    return this.tracks.find((one) => one.key === key) || null;
  }

  setMission(mission) {
    this.missions.set(mission.id, mission);
    this.emit("missions");
  }

  removeMission(id) {
    this.missions.delete(id);
    for (const [key, object] of this.objects) if (object.mission === id) this.objects.delete(key);
    this.emit("missions");
    this.emit("objects");
  }

  setShown(key, shown) {
    this.ticked.set(key, shown);
    this.emit("shown");
  }

  /** Apply a change of how a track looks. @param {number} id of its mission @param {Object} received the track */
  setLook(id, { id: trackId, look }) {
    const key = keyOf(id, trackId);
    const track = this.track(key)?.track;
    if (!track) return;
    if (track.look.hidden !== look.hidden) this.ticked.delete(key);
    track.look = look;
    this.emit("shown");
  }

  setMode(mode) {
    this.mode = mode;
    this.emit("mode");
  }

  /** @param {?number} moment seconds since the start of the timeline; null: now */
  setMoment(moment) {
    this.moment = moment;
    this.emit("moment");
  }

  /** @param {number} mission @param {Array<Object>} objects as returned by the server */
  setObjects(mission, objects) {
    for (const object of objects) this.objects.set(keyOf(mission, object.id), { ...object, mission, key: keyOf(mission, object.id) });
    this.emit("objects");
  }

  /** @param {Array<{time: number, lat: number, lon: number, radius_m: ?number, gated: boolean}>} fixes of the page's mission */
  setFixes(fixes) {
    this.fixes = fixes;
    this.emit("fixes");
  }

  /** @param {?Set<string>} keys of the objects that pass the filter; null: all */
  setMatching(keys) {
    this.matching = keys;
    this.emit("matching");
  }

  /** @param {?string} key of an object */
  choose(key) {
    if (this.chosen === key) return;
    this.chosen = key;
    this.trail = [];
    this.emit("chosen");
  }

  /** @param {Array<{lat: number, lon: number}>} places at which the chosen object was seen */
  setTrail(places) {
    this.trail = places;
    this.emit("trail");
  }

  /** Where something is drawn, while nothing else says where the mission is. @param {[number, number]} place degrees */
  setDrawn(place) {
    this.drawn = place;
    this.emit("grown");
  }

  /** Replace the state of a mission; fires `missed` for tracks with new poses, which must be fetched. */
  refresh(mission) {
    const before = new Map(this.missions.get(mission.id)?.tracks.map((track) => [track.id, track.poses]));
    this.setMission(mission);
    for (const { id, poses } of mission.tracks) {
      if (before.has(id) && before.get(id) < poses) this.emit("missed", { key: keyOf(mission.id, id) });
    }
    this.emit("grown");
  }

  /** Apply an event of the server. */
  merge(id, { tracks, track_ids: left = null, objects, ...facts }) {
    const mission = this.missions.get(id);
    if (!mission) return;
    Object.assign(mission, facts);
    const known = new Map(mission.tracks.map((track) => [track.id, track]));
    const added = tracks.filter((received) => !known.has(received.id));
    const restyled = tracks.some(({ id: one, look }) => JSON.stringify(look) !== JSON.stringify(known.get(one)?.look));
    for (const { new: points, ...received } of tracks) {
      if (known.has(received.id)) Object.assign(known.get(received.id), received);
      else mission.tracks.push(received);
      if (points.length) this.emit("poses", { key: keyOf(id, received.id), points, first: known.size > 0 && !known.has(received.id) });
    }
    const kept = mission.tracks.filter((track) => left === null || left.includes(track.id));
    const removed = kept.length < mission.tracks.length;
    mission.tracks = kept;
    if (objects.length) this.setObjects(id, objects);
    if (added.length || removed) this.emit("missions");
    else if (restyled) this.emit("shown");
    this.emit("grown");
  }

  /**
   * The timeline from the first to the last pose of all missions. Missions far apart in time begin together.
   * @returns {?{first: number, span: number, aligned: boolean}} Unix seconds, seconds
   */
  get clock() {
    const times = [...this.missions.values()].map(timesOf).filter(Boolean);
    if (!times.length) return null;
    const first = Math.min(...times.map(([from]) => from));
    const span = Math.max(...times.map(([, to]) => to)) - first;
    const longest = Math.max(...times.map(([from, to]) => to - from));
    const aligned = times.length > 1 && span > APART * longest;
    return { first, span: aligned ? longest : span, aligned };
  }

  /** Unix seconds of the moment in a mission; Infinity for now. */
  timeIn(mission, moment = this.moment) {
    if (moment === null) return Infinity;
    const clock = this.clock;
    return moment + (clock.aligned ? timesOf(mission)?.[0] ?? clock.first : clock.first);
  }

  /** The moment of the timeline for a time of a mission. */
  momentOf(mission, time) {
    const clock = this.clock;
    return time - (clock.aligned ? timesOf(mission)?.[0] ?? clock.first : clock.first);
  }
}

/** Key of a track or object among those of all missions. */
export const keyOf = (mission, id) => `${mission}/${id}`;

function timesOf({ tracks }) {
  const known = tracks.filter(({ first_time_s: first }) => first !== null && first !== undefined);
  if (!known.length) return null;
  return [Math.min(...known.map((track) => track.first_time_s)), Math.max(...known.map((track) => track.last_time_s))];
}
