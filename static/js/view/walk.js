/** The way through the photos: their order, which of them are on it, and the steps from each. */

/** @typedef {"by_time"|"by_place"} Order */
/** @typedef {{id: number, bearing: number, turn: boolean}} Step `bearing` clockwise from north; `turn`: on the same spot */

/** Order and filters; fires `change`. */
export class Walk extends EventTarget {
  /**
   * @param {import("../shared/map/map-store.js").MapStore} store
   * @param {{by_time: number[], by_place: number[], steps: Object<string, number[][]>}} walk as the server plans it
   * @param {Order} order
   */
  constructor(store, walk, order) {
    super();
    this.store = store;
    this.walk = walk;
    this.order = order;
    /** A day as YYYY-MM-DD, and the name of a camera; empty for all. */
    this.day = "";
    this.camera = "";
    store.on("photos", () => this._change());
    this._find();
  }

  /** Whether the server has an order by time. */
  get hasTimes() {
    return this.walk.by_time.length > 0;
  }

  /** @param {Partial<{order: Order, day: string, camera: string}>} choice */
  choose(choice) {
    Object.assign(this, choice);
    this._change();
  }

  /** The photo that many steps farther on the way; null beyond its ends. @param {number} by @returns {?number} */
  after(by) {
    const at = this.ids.indexOf(this.store.currentId);
    return (at < 0 ? this.ids[0] : this.ids[at + by]) ?? null;
  }

  /** Steps from a photo. @param {number} id @returns {Step[]} */
  steps(id) {
    return (this.walk.steps[id] ?? []).map(([to, bearing, turn]) => ({ id: to, bearing, turn: turn === 1 }));
  }

  /** Days of the photos, with how many they are, the first day first. @returns {Map<string, number>} */
  days() {
    return counted(this._all().map((photo) => dayOf(photo)).sort());
  }

  /** Cameras of the photos, with how many they are, by name. @returns {Map<string, number>} */
  cameras() {
    return counted(this._all().map(({ camera }) => camera ?? "").sort());
  }

  _all() {
    return this.walk.by_place.map((id) => this.store.photos.get(id)).filter((photo) => photo && this.store.isKnown(photo.id));
  }

  _find() {
    const fits = (photo) => (!this.day || dayOf(photo) === this.day) && (!this.camera || photo.camera === this.camera);
    /** Ids of the photos on the way. */
    this.ids = this.walk[this.hasTimes ? this.order : "by_place"].filter((id) => fits(this.store.photos.get(id)));
  }

  _change() {
    this._find();
    this.dispatchEvent(new Event("change"));
  }
}

/** Day on which a photo was taken; empty if unknown. */
export function dayOf(photo) {
  return photo.taken_at?.slice(0, 10) ?? "";
}

/** How often each text that is not empty occurs, in their order. */
function counted(texts) {
  const counts = new Map();
  for (const text of texts) if (text) counts.set(text, (counts.get(text) ?? 0) + 1);
  return counts;
}
