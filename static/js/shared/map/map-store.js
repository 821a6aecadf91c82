/**
 * State of the page: the map as the server last sent it, overlaid with unsaved edits.
 *
 * Three layers give a photo's position, in this order: `preview` (being dragged), `pending` (edits that the server
 * has not confirmed), and the server's state. So no response and no change of others reverts what is shown.
 */

import { Georeference } from "./coords.js";

/** @typedef {{x_px: ?number, y_px: ?number, heading_deg: ?number, removed: boolean}} View */
/** @typedef {Required<Api["FloorOut"]>} Floor */

const NAMES = new Intl.Collator(undefined, { numeric: true });
/** Id of the floor of the map's own image. */
export const BASE_FLOOR = 0;
/** Revision of a photo of which only the dot is loaded. */
const DOT_REVISION = -1;

/** State of the page; fires an event named after what changed. */
export class MapStore extends EventTarget {
  /** @param {Object} state answer of `GET /api/v1/maps/SLUG`; pages of large maps have `dots` for most of their photos */
  constructor(state) {
    super();
    this.slug = state.slug;
    this.name = state.name;
    this.canEdit = state.can_edit;
    this.revision = state.revision;
    this.photos = new Map(photosOf(state).map((photo) => [photo.id, photo]));
    this.placements = placementsOf(state.placements);
    /** @type {import("./note-layer.js").Note[]} notes at positions on the map */
    this.notes = state.notes ?? [];
    /** @type {Floor[]} the lowest first; empty if the map has only one image */
    this.floors = state.floors ?? [];
    /** Id of the floor that is shown; 0 is that of the map's own image. */
    this.floor = BASE_FLOOR;
    this.history = { undo: state.undo, redo: state.redo };
    this.pending = new Map();
    this.preview = new Map();
    /** @type {?{id: number, turn: number, fov: number}} view in a panorama, relative to its middle; degrees */
    this.look = null;
    this.placement = null;
    this.currentId = null;
    this.selection = new Set();
    this.tool = "select";
    this.jobs = [];
    this.people = [];
    this._unplaced = null;
    this._reorder();
    this._setSatellite(state.satellite, state.georeference);
  }

  /** Notify listeners. */
  emit(name) {
    this.dispatchEvent(new Event(name));
  }

  /** Call a function on some events. */
  on(names, run) {
    for (const name of names.split(" ")) this.addEventListener(name, run);
  }

  /** Ids of all photos by time, then by name. */
  get order() {
    this._sorted ??= sorted(this.photos);
    this._order ??= this._sorted.filter((id) => this._stays(id));
    return this._order;
  }

  /** Ids of all photos by name. */
  get byName() {
    this._named ??= [...this.photos.values()].sort(compareNames).map((photo) => photo.id);
    return this._named.filter((id) => this._stays(id));
  }

  /** Whether no pending edit removes a photo. */
  _stays(id) {
    return !this.pending.get(pendingKey(null, id))?.removed;
  }

  /** Clear the cached orders: photos were added or removed, or their time or name changed. */
  _reorder() {
    /** Ids by time and by name; `_order` without those that a pending edit removes. */
    this._sorted = this._named = this._order = null;
  }

  get current() {
    return this.currentId === null ? null : this.photos.get(this.currentId) || null;
  }

  /**
   * Position of a photo in the placement that is shown.
   * @returns {?[number, number]} null for a photo in the tray
   */
  position(id) {
    const over = this._over(id, "x_px");
    if (over) return over.x_px === null ? null : [over.x_px, over.y_px];
    if (this.placement !== null) return this.placements.get(this.placement)?.get(id) || null;
    const photo = this.photos.get(id);
    return !photo || photo.x_px === null ? null : [photo.x_px, photo.y_px];
  }

  /** Radius of uncertainty of a suggested position, pixels; null for one set by hand or from GPS. */
  radius(id) {
    if (this.placement !== null || this._over(id, "x_px")) return null;
    return this.photos.get(id)?.radius_px ?? null;
  }

  /** Id of the floor that the photo is on. */
  floorOf(id) {
    return this._over(id, "floor")?.floor ?? this.photos.get(id)?.floor ?? BASE_FLOOR;
  }

  /** Whether the photo is on the floor that is shown. */
  isOnFloor(id) {
    return !this.floors.length || this.floorOf(id) === this.floor;
  }

  /** The floor with an id; null if the map has none. @returns {?Floor} */
  floorNamed(id) {
    return this.floors.find((floor) => floor.id === id) ?? null;
  }

  /** Heading of a photo, degrees clockwise from north; null if unknown. */
  heading(id) {
    const over = this._over(id, "heading_deg");
    return over ? over.heading_deg : (this.photos.get(id)?.heading_deg ?? null);
  }

  isPlaced(id) {
    return this.position(id) !== null;
  }

  /** Ids of the photos in the tray, by time. */
  unplaced() {
    this._unplaced ??= this.order.filter((id) => !this.isPlaced(id));
    return this._unplaced;
  }

  /** Whether the details of a photo are loaded, not only its dot. */
  isKnown(id) {
    return (this.photos.get(id)?.revision ?? 0) !== DOT_REVISION;
  }

  /** Add details that were not in the page; photos that were removed or updated meanwhile are skipped. */
  addDetails(photos) {
    for (const photo of photos) if (this.photos.has(photo.id) && !this.isKnown(photo.id)) this.photos.set(photo.id, photo);
    this._reorder();
    this._photosChanged();
  }

  _over(id, field) {
    if (!this.preview.size && !this.pending.size) return null;
    const previewed = this.preview.get(id);
    if (previewed && field in previewed) return previewed;
    const waiting = this.pending.get(pendingKey(field === "x_px" ? this.placement : null, id));
    return waiting && field in waiting ? waiting : null;
  }

  /** Replace the edits over the server's state. @param {Map<string, Object>} pending by `pendingKey` */
  setPending(pending) {
    this.pending = pending;
    this._order = null;
    this._photosChanged();
  }

  /** Show changes while dragging. @param {Map<number, Object>} preview by id */
  setPreview(preview) {
    if (!preview.size && !this.preview.size) return;
    this.preview = preview;
    this._unplaced = null;
    this.emit("preview");
  }

  /** Show the viewing direction in a panorama. @param {?{id: number, turn: number, fov: number}} look */
  setLook(look) {
    this.look = look;
    this.emit("look");
  }

  /** Merge the response to an edit, or changes of other people. */
  merge(changes) {
    for (const photo of changes.photos || []) this._mergePhoto(photo);
    this._unplaced = null;
    if (changes.placements) this.placements = placementsOf(changes.placements);
    if (changes.notes && JSON.stringify(changes.notes) !== JSON.stringify(this.notes)) {
      this.notes = changes.notes;
      this.emit("notes");
    }
    if (changes.floors && JSON.stringify(changes.floors) !== JSON.stringify(this.floors)) this._setFloors(changes.floors);
    if (this.placement !== null && !this.placements.has(this.placement)) this.showPlacement(null); // it was deleted
    if ("undo" in changes) this.history = { undo: changes.undo, redo: changes.redo };
    if ("satellite" in changes) {
      this._setSatellite(changes.satellite, changes.georeference ?? null);
      this.emit("satellite");
    }
    if (changes.photos?.length || changes.placements) this._photosChanged();
    this.emit("history");
  }

  _mergePhoto(photo) {
    if (!photo.removed) {
      const known = this.photos.get(photo.id);
      if (!known || photo.revision >= known.revision) this.photos.set(photo.id, photo);
      if (known?.name !== photo.name || known.taken_at !== photo.taken_at) this._reorder();
      return;
    }
    this._reorder();
    this.photos.delete(photo.id);
    this.selection.delete(photo.id);
    if (this.currentId === photo.id) this.setCurrent(null);
  }

  _setFloors(floors) {
    this.floors = floors;
    if (!this.floorNamed(this.floor)) this.floor = BASE_FLOOR;
    this.emit("floor");
  }

  /** Show a floor. @param {number} id */
  showFloor(id) {
    if (id === this.floor || !this.floorNamed(id)) return;
    this.floor = id;
    this.emit("floor");
  }

  _setSatellite(satellite, georeference) {
    this.satellite = satellite;
    this.georeference = new Georeference(georeference, satellite);
  }

  /** Make a photo the current one; an unplaced one can then be placed by a click. */
  setCurrent(id) {
    this.currentId = id;
    if (id !== null && this.isPlaced(id)) this.showFloor(this.floorOf(id));
    const place = this.canEdit && id !== null && !this.isPlaced(id);
    this.setTool(place ? "place" : "select");
    this.emit("current");
  }

  /** @param {"place"|"select"} tool meaning of a click on the image */
  setTool(tool) {
    if (tool === this.tool) return;
    this.tool = tool;
    this.emit("tool");
  }

  /** @param {Iterable<number>} ids */
  setSelection(ids) {
    this.selection = new Set(ids);
    this.emit("selection");
  }

  toggleSelected(id) {
    const ids = new Set(this.selection);
    if (!ids.delete(id)) ids.add(id);
    this.setSelection(ids);
  }

  /** @param {?string} name null for the exact positions */
  showPlacement(name) {
    this.placement = name;
    this._unplaced = null;
    this.emit("placement");
    this._photosChanged();
  }

  _photosChanged() {
    this._unplaced = null;
    this.emit("photos");
  }

  setJobs(jobs) {
    this.jobs = jobs;
    this.emit("jobs");
  }

  setPeople(people) {
    this.people = people;
    this.emit("people");
  }
}

/** The photos with details in the page, then those with only a dot. */
function photosOf({ photos, dots }) {
  const ids = dots?.id ?? [];
  const drawn = ids.map((id, n) => ({
    id,
    x_px: dots.x_px[n],
    y_px: dots.y_px[n],
    heading_deg: dots.heading_deg[n],
    fov_deg: dots.fov_deg[n],
    floor: dots.floor[n],
    name: "",
    taken_at: null,
    revision: DOT_REVISION,
  }));
  return [...photos, ...drawn];
}

/** Ids by time, then by name; photos without details, which have neither, at the end. */
function sorted(photos) {
  const time = (photo) => photo.taken_at || (photo.revision === DOT_REVISION ? "9999z" : "9999");
  return [...photos.values()]
    .sort((a, b) => (time(a) < time(b) ? -1 : time(a) > time(b) ? 1 : compareNames(a, b)))
    .map((photo) => photo.id);
}

/** By name, with numbers as numbers. */
function compareNames(a, b) {
  return NAMES.compare(a.name, b.name) || a.id - b.id;
}

/** Key of a photo's fields in `pending`: positions belong to a placement, headings to the photo. */
export function pendingKey(placement, id) {
  return `${placement ?? ""}/${id}`;
}

function placementsOf(placements) {
  return new Map(
    (placements || []).map(({ name, positions }) => [
      name,
      new Map(Object.entries(positions).map(([id, position]) => [Number(id), position])),
    ]),
  );
}
