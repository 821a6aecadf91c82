/** Actions on the photos, used by buttons, keys, clicks and gestures. */

import { t, tn } from "../shared/i18n.js";
import { clamped, wholeTurn } from "../shared/map/coords.js";
import { toast } from "../shared/toast.js";
import { WRITTEN } from "../shared/written-facts.js";
import { stepName } from "./undo-redo.js";

/** The actions of the page. */
export class Commands {
  /**
   * @param {import("../shared/map/map-store.js").MapStore} store
   * @param {import("./edit-queue.js").EditQueue} edits
   * @param {import("./photos/photo-order.js").PhotoOrder} order for stepping through the photos
   * @param {function(string): void} say announces to a screen reader
   */
  constructor(store, edits, order, say) {
    this.store = store;
    this.edits = edits;
    this.order = order;
    this.say = say;
    /** @type {?function(): void} removes the last message */
    this._toast = null;
    edits.addEventListener("saved", (event) => this._follow(/** @type {CustomEvent} */ (event).detail));
  }

  /** Place the current photo at a map pixel, and continue with the next one in the tray. */
  placeCurrent(pixel) {
    const { store } = this;
    const photo = store.current;
    if (!photo || !store.canEdit || !store.satellite) return;
    const wasPlaced = store.isPlaced(photo.id);
    const [x, y] = clamped(pixel, store.satellite);
    this._edit(wasPlaced ? "move" : "place", [{ id: photo.id, x_px: x, y_px: y, ...this._floor() }]);
    if (wasPlaced) {
      this.say(t("{name} moved to {x}, {y}", { name: photo.name, x: Math.round(x), y: Math.round(y) }));
      return;
    }
    const next = this._nextUnplaced(photo.id);
    const left = store.unplaced().length;
    if (next !== null) store.setCurrent(next);
    else store.setTool("select");
    this.say(
      next === null
        ? t("{name} placed. All photos are placed.", { name: photo.name })
        : tn("{name} placed. {n} photo is left, now {next}.", "{name} placed. {n} photos are left, now {next}.", left, {
            name: photo.name,
            next: store.current.name,
          }),
    );
  }

  /** Place photos at one position, for example dragged there from the grid. @param {number[]} ids */
  placeAt(ids, pixel) {
    const { store } = this;
    const there = ids.filter((id) => store.photos.has(id));
    if (there.length === 1) {
      store.setCurrent(there[0]);
      this.placeCurrent(pixel);
    } else if (there.length) {
      const [x_px, y_px] = clamped(pixel, store.satellite);
      this._edit(there.some((id) => store.isPlaced(id)) ? "move" : "place", there.map((id) => ({ id, x_px, y_px, ...this._floor() })));
      this.say(tn("{n} photo placed.", "{n} photos placed.", there.length));
    }
  }

  /** The floor field of a placed photo: the shown floor; other placements use the floors of the exact one. */
  _floor() {
    const { floor, floors, placement } = this.store;
    return floors.length && placement === null ? { floor } : {};
  }

  /** Move photos to another floor, and show it. @param {number[]} ids @param {number} floor */
  toFloor(ids, floor) {
    const { store } = this;
    const placed = ids.filter((id) => store.isPlaced(id) && store.floorOf(id) !== floor);
    if (!placed.length) return;
    this._edit("floor", placed.map((id) => ({ id, floor })));
    store.showFloor(floor);
    this.say(tn("{n} photo moved to {floor}.", "{n} photos moved to {floor}.", placed.length, { floor: store.floorNamed(floor)?.name ?? "" }));
  }

  /** Move photos. @param {Map<number, [number, number]>} positions */
  move(positions) {
    const { satellite } = this.store;
    const changes = [...positions].map(([id, pixel]) => {
      const [x_px, y_px] = clamped(pixel, satellite);
      return { id, x_px, y_px };
    });
    if (changes.length) this._edit("move", changes);
  }

  /** Set the heading of a photo. @param {?number} degrees clockwise from north */
  turn(id, degrees) {
    const heading_deg = degrees === null ? null : wholeTurn(degrees);
    this._edit("turn", [{ id, heading_deg }]);
    if (heading_deg !== null) this.say(t("Heading {degrees}°", { degrees: heading_deg }));
  }

  /** Set the headings of several photos. @param {Map<number, ?number>} headings degrees clockwise from north, by id */
  turnAll(headings) {
    const changes = [...headings].map(([id, degrees]) => ({ id, heading_deg: degrees === null ? null : wholeTurn(degrees) }));
    if (!changes.length) return;
    this._edit("turn", changes);
    this.say(tn("{n} photo turned.", "{n} photos turned.", changes.length));
  }

  /** Correct the times of photos whose camera had a wrong clock. @param {Map<number, string>} times by id */
  retime(times) {
    if (!times.size) return;
    this._edit("retime", [...times].map(([id, taken_at]) => ({ id, taken_at })));
    this.say(tn("The time of {n} photo is corrected.", "The times of {n} photos are corrected.", times.size));
  }

  /** Write a text of a photo. @param {number} id @param {string} name of the text, one of `WRITTEN` @param {string} words */
  write(id, name, words) {
    const { kind } = WRITTEN.find((fact) => fact.name === name);
    if ((this.store.photos.get(id)?.[name] ?? "") !== words) this._edit(kind, [{ id, [name]: words }]);
  }

  /** Write the notes of several photos. @param {Map<number, string>} notes by id */
  noteAll(notes) {
    const changed = [...notes].filter(([id, note]) => (this.store.photos.get(id)?.note ?? "") !== note);
    if (!changed.length) return;
    this._edit("note", changed.map(([id, note]) => ({ id, note })));
    this.say(tn("The note of {n} photo is changed.", "The notes of {n} photos are changed.", changed.length));
  }

  /** Turn the current photo by some degrees; without a heading, from north. */
  turnBy(degrees) {
    const { current, canEdit } = this.store;
    if (current && canEdit) this.turn(current.id, (this.store.heading(current.id) ?? 0) + degrees);
  }

  /** Move photos back to the tray; a click on the image does not place the current one again until it is selected anew. */
  toTray(ids) {
    const placed = ids.filter((id) => this.store.isPlaced(id));
    if (!placed.length) return;
    this._edit("unplace", placed.map((id) => ({ id, x_px: null, y_px: null })));
    this.store.setTool("select");
    this.say(tn("{n} photo is back in the tray", "{n} photos are back in the tray", placed.length));
  }

  /** Remove photos from the map. */
  remove(ids) {
    if (!ids.length) return;
    const next = ids.includes(this.store.currentId) ? this._neighbour(1, (id) => !ids.includes(id)) : undefined;
    this.edits.remove(ids);
    const words = tn("{n} photo removed.", "{n} photos removed.", ids.length);
    this._show(words, { action: { label: t("Undo"), run: () => this.history("undo") } });
    this.store.setSelection([...this.store.selection].filter((id) => !ids.includes(id)));
    if (next !== undefined) this.store.setCurrent(next);
  }

  /** Photos that Delete applies to: the selection, else the current photo. */
  chosen() {
    const { selection, currentId } = this.store;
    if (selection.size) return [...selection];
    return currentId === null ? [] : [currentId];
  }

  /** Go to the next or previous photo that passes the filters: in the tray while placing, else of all. */
  step(direction) {
    const { order, store } = this;
    const placing = store.currentId === null || !store.isPlaced(store.currentId);
    const keep = placing && store.unplaced().length ? (id) => !store.isPlaced(id) : () => true;
    const id = this._neighbour(direction, (other) => keep(other) && order.passes(other));
    if (id === null || id === store.currentId) return;
    store.setCurrent(id);
    const announcement = store.isPlaced(id) ? t("{name}, placed", { name: store.current.name }) : store.current.name;
    this.say(announcement);
  }

  /** @param {"undo"|"redo"} action */
  history(action) {
    if (this.store.history[action] || (action === "undo" && this.edits.waiting)) this.edits.step(action);
  }

  /** After undo or redo, show the affected photo and name the step, which need not be the last action. */
  _follow({ item, answer }) {
    if (item.action !== "undo" && item.action !== "redo") return;
    const touched = (answer.photos || []).filter((photo) => !photo.removed);
    if (touched.length === 1) this.store.setCurrent(touched[0].id);
    const step = item.action === "undo" ? answer.redo : answer.undo;
    const what = step ? stepName(step) : t("the last change");
    this._show(item.action === "undo" ? t("Undone: {what}", { what }) : t("Redone: {what}", { what }));
  }

  /** Warn that a photo cannot be placed outside the image. */
  warnOutside() {
    this.warn(t("That is outside the image."), t("Click on the image where the photo was taken."));
  }

  /** Show why something was not done. @param {string} message @param {string} hint */
  warn(message, hint) {
    this._show(message, { hint });
  }

  /** Show a message instead of the previous one, whose button may no longer apply. */
  _show(message, options = {}) {
    this._toast?.();
    this._toast = toast(message, options);
  }

  _edit(kind, changes) {
    this._toast?.();
    this.edits.edit(kind, changes);
  }

  _nextUnplaced(after) {
    const waits = (id) => id !== after && !this.store.isPlaced(id);
    return this._neighbour(1, (id) => waits(id) && this.order.passes(id), after) ?? this._neighbour(1, waits, after);
  }

  _neighbour(direction, keep, from = this.store.currentId) {
    const order = this.order.sorted();
    const start = order.indexOf(from);
    for (let n = 1; n <= order.length; n += 1) {
      const at = start < 0 && direction < 0 ? order.length - n : start + direction * n;
      const id = order[((at % order.length) + order.length) % order.length];
      if (keep(id)) return id;
    }
    return null;
  }
}
