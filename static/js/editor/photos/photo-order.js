/** Filters and order of the photos in the grid, also used for stepping through them by keys. */

import { WRITTEN } from "../../shared/written-facts.js";
import { tagsOf } from "./tags.js";

/** Filters that pass every photo; that of a written text can be a tag with its #, or a whole text after =. */
const EVERY = { gps: "any", heading: "any", accuracy: "any", camera: "any", ...Object.fromEntries(WRITTEN.map(({ name }) => [name, "any"])), from: "", to: "", text: "" };

/** Filter value for photos with an unknown camera. */
const UNKNOWN = "unknown";

/** Sorting and filters; fires `change`. */
export class PhotoOrder extends EventTarget {
  /** @param {import("../../shared/map/map-store.js").MapStore} store */
  constructor(store) {
    super();
    this.store = store;
    /** @type {"unplaced"|"placed"|"all"} */
    this.place = store.order.length && !store.unplaced().length ? "all" : "unplaced";
    /** @type {"time"|"name"|"placed"|"distance"} */
    this.sort = "time";
    /** Distances are from this photo, also after another becomes the current one. */
    this.reference = null;
    this.filters = { ...EVERY };
  }

  /** @param {"unplaced"|"placed"|"all"} place */
  show(place) {
    this.place = place;
    this._changed();
  }

  /** @param {"time"|"name"|"placed"|"distance"} sort @param {?number} [reference] photo that distances are from */
  sortBy(sort, reference = this.store.currentId) {
    this.sort = sort;
    this.reference = reference;
    this._changed();
  }

  /** @param {Partial<typeof EVERY>} changes */
  filter(changes) {
    Object.assign(this.filters, changes);
    this._changed();
  }

  /** Clear all filters except the search text. */
  clear() {
    this.filter({ ...EVERY, text: this.filters.text });
  }

  /** Number of active filters without the search. */
  get active() {
    const { from, to, ...others } = this.filters;
    return [from || to, ...Object.entries(others).map(([name, value]) => name !== "text" && value !== "any")].filter(Boolean).length;
  }

  /** Ids of all photos in the chosen order. */
  sorted() {
    const { store } = this;
    if (this.sort === "name") return store.byName;
    if (this.sort === "placed") return [...store.order.filter((id) => store.isPlaced(id)), ...store.unplaced()];
    return this.sort === "distance" ? this._byDistance() : store.order;
  }

  /** Ids of the shown photos. */
  shown() {
    const { place, store } = this;
    return this.sorted().filter((id) => (place === "all" || store.isPlaced(id) === (place === "placed")) && this.passes(id));
  }

  /** Whether a photo passes search and filters, placed or not. */
  passes(id) {
    const { gps, heading, accuracy, camera, from, to, text } = this.filters;
    const photo = this.store.photos.get(id);
    const written = WRITTEN.map(({ name }) => ({ words: photo[name] ?? "", choice: this.filters[name] }));
    if (text && ![photo.name, ...written.map(({ words }) => words)].join(" ").toLowerCase().includes(text.toLowerCase())) return false;
    if ([gps, camera, ...written.map(({ choice }) => choice)].some((choice) => choice !== "any") && !this.store.isKnown(id)) return false; // not loaded
    if (gps !== "any" && Boolean(photo.gps) !== (gps === "yes")) return false;
    if (heading !== "any" && (this.store.heading(id) !== null) !== (heading === "yes")) return false;
    if (accuracy !== "any" && !(this.store.isPlaced(id) && Number.isFinite(photo.radius_px) === (accuracy === "suggested"))) return false;
    if (!written.every(({ words, choice }) => fits(words, choice))) return false;
    if (camera === UNKNOWN ? photo.camera : camera !== "any" && photo.camera !== camera) return false;
    if (!from && !to) return true;
    const day = photo.taken_at?.slice(0, 10);
    return Boolean(day) && (!from || day >= from) && (!to || day <= to);
  }

  /** By distance from the reference; photos without any position last, by time. */
  _byDistance() {
    const from = this.reference === null ? null : this._spot(this.reference);
    if (!from) return this.store.order;
    const away = new Map(this.store.order.map((id) => {
      const spot = this._spot(id);
      return [id, spot ? Math.hypot(spot[0] - from[0], spot[1] - from[1]) : Infinity];
    }));
    return this.store.order.toSorted((a, b) => (away.get(a) === away.get(b) ? 0 : away.get(a) - away.get(b)));
  }

  /** Position of a photo, else that of its GPS. */
  _spot(id) {
    const gps = this.store.photos.get(id)?.gps;
    return this.store.position(id) ?? (Number.isFinite(gps?.x_px) ? [gps.x_px, gps.y_px] : null);
  }

  _changed() {
    this.dispatchEvent(new Event("change"));
  }
}

/** Whether a written text passes its filter. @param {string} words @param {string} choice */
function fits(words, choice) {
  if (choice.startsWith("#")) return tagsOf(words).includes(choice.slice(1));
  if (choice.startsWith("=")) return words === choice.slice(1);
  return choice === "any" || Boolean(words) === (choice === "yes");
}
