/** The search areas, lines and markers of the page's mission, their coverage, and the shape being drawn. */

import { toastError } from "../../shared/toast.js";

/** Coverage changes with every pose: it is asked for again at most this often. */
const COVERAGE_MS = 10_000;

/** Fires `change` when drawings, coverage or the choice changed, `sketch` when the shape being drawn did. */
export class DrawingStore extends EventTarget {
  /** @param {import("../mission-store.js").MissionStore} store */
  constructor(store) {
    super();
    this.store = store;
    this.list = [];
    this.coverage = new Map();
    this.chosen = null;
    /** @type {?{kind: string, points: Array<[number, number]>, done: function(Array<[number, number]>): void}} */
    this.sketch = null;
    this._server = store.server(store.id);
    this._known = null;
    this._poses = "";
    this._next = 0;
    store.on("missions grown poses missed", () => this._look());
    this._look();
  }

  /** Whether the caller may draw. */
  get canEdit() {
    return Boolean(this.store.mission.can_edit);
  }

  find(id) {
    return this.list.find((one) => one.id === id) || null;
  }

  /** @param {?number} id */
  choose(id) {
    this.chosen = id;
    this._changed();
  }

  async add(fields) {
    const added = await this._server.addDrawing(fields);
    this._put(added);
    return added;
  }

  /** Change a drawing that has not been changed by others; on a conflict, the latest state is shown. */
  async change(drawing, fields) {
    await this._attempt(async () => this._put(await this._server.changeDrawing(drawing.id, { ...fields, revision: drawing.revision })));
  }

  async remove(drawing) {
    await this._attempt(async () => {
      await this._server.deleteDrawing(drawing.id, drawing.revision);
      this.list = this.list.filter(({ id }) => id !== drawing.id);
      this._changed();
    });
  }

  /** Begin to draw; `done` gets the points. @param {string} kind @param {function(Array<[number, number]>): void} done */
  draw(kind, done) {
    this.sketch = { kind, points: [], done };
    this.dispatchEvent(new Event("sketch"));
  }

  /** @param {Array<[number, number]>} points */
  setSketch(points) {
    this.sketch.points = points;
    this.dispatchEvent(new Event("sketch"));
  }

  stopSketch() {
    this.sketch = null;
    this.dispatchEvent(new Event("sketch"));
  }

  async _attempt(run) {
    try {
      await run();
    } catch (error) {
      if (error.status === 409 || error.status === 404) await this._load();
      throw error;
    }
  }

  _put(drawing) {
    const others = this.list.filter(({ id }) => id !== drawing.id);
    this.list = [...others, drawing].sort((a, b) => a.id - b.id);
    this._changed();
    this._measure(0);
  }

  /** Ask for what has changed on the server. */
  _look() {
    const { drawings_revision: revision, tracks } = this.store.mission;
    const poses = tracks.map(({ id, poses: count }) => `${id}.${count}`).join();
    if (revision !== this._known) {
      this._known = revision;
      this._load().catch(toastError);
    } else if (poses !== this._poses) this._measure(COVERAGE_MS);
    this._poses = poses;
  }

  async _load() {
    if (!this._known && !this.list.length) return; // nobody has drawn anything
    const { drawings } = await this._server.drawings();
    const first = !this.list.length && drawings.length;
    this.list = drawings;
    this._changed();
    if (first) this.store.setDrawn(drawings[0].points[0]);
    this._measure(0);
  }

  /** @param {number} wait milliseconds at most until coverage is asked for */
  _measure(wait) {
    if (!this.list.some(({ kind }) => kind === "area")) return;
    if (wait && this._next) return;
    clearTimeout(this._next);
    this._next = setTimeout(async () => {
      this._next = 0;
      try {
        const { areas } = await this._server.coverage();
        this.coverage = new Map(areas.map((one) => [one.id, one]));
        this._changed();
      } catch (error) {
        if (error.status === undefined) throw error; // the next poses ask again
      }
    }, wait);
  }

  _changed() {
    if (this.chosen !== null && !this.find(this.chosen)) this.chosen = null;
    this.dispatchEvent(new Event("change"));
  }
}

/** State of an area: `searched`, `assigned` or `open`; of other kinds `line`. */
export function stateOf({ kind, searched, assigned }) {
  if (kind !== "area") return "line";
  return searched ? "searched" : assigned ? "assigned" : "open";
}

/** Colours by state, as in exports; the fill of an area is the same colour, transparent. */
export const COLOURS = { open: "#6a3d9a", assigned: "#b15928", searched: "#1b7837", line: "#d01c8b" };
