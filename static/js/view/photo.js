/** The current photo, large, flat or from inside; what is known of it; and the next ones, loaded ahead. */

import { byId, h, icon } from "../shared/dom.js";
import { clockText } from "../shared/format.js";
import { t } from "../shared/i18n.js";
import { noteDialog } from "../shared/map/note-layer.js";
import { insideOf, PanoramaView } from "../shared/panorama-view.js";
import { factElements, photoFacts } from "../shared/photo-facts.js";
import { PhotoZoom } from "../shared/photo-zoom.js";
import { ProgressiveImage } from "../shared/progressive-image.js";

/** Pictures kept decoded in memory, those used last at the end. */
const KEPT = 24;
const SWIPE_PX = 60;

/** Follows the store. */
export class PhotoFrame {
  /** @param {import("./walk.js").Walk} walk @param {function(1|-1): void} step */
  constructor(walk, step) {
    this.walk = walk;
    this.store = walk.store;
    this.frame = byId("photo-frame");
    this.image = byId("photo-image", HTMLImageElement);
    this.picture = new ProgressiveImage(this.frame, this.image);
    this.zoom = new PhotoZoom(this.frame, this.image);
    this.around = new PanoramaView(this.image);
    /** @type {Map<string, HTMLImageElement>} by address */
    this.ahead = new Map();
    /** @type {?number} where one looks, clockwise from north; null before the first photo with a heading */
    this.facing = null;
    this.image.addEventListener("load", () => this.frame.style.setProperty("--tall", String(this.image.naturalHeight / this.image.naturalWidth)));
    this.around.addEventListener("look", () => this._look());
    this.store.on("current photos", () => this._show());
    this._swipe(step);
    this._show();
  }

  _show() {
    const photo = this.store.current;
    if (!photo) return;
    const named = { ...photo, name: photo.name || t("Photo") };
    if (this.picture.show(named)) {
      this.zoom.reset();
      this._stopOthers(photo.preview);
    }
    this._inside(named);
    byId("photo-name").textContent = photo.name ?? ""; // a share may leave it out
    byId("photo-when").textContent = photo.taken_at ? clockText(photo.taken_at) : "";
    byId("photo-facts").replaceChildren(...factElements(photoFacts(this.store, photo)));
    this._notes(photo);
    this._loadAhead(photo);
  }

  /** Show a panorama from inside, looking in the direction of the photo before. */
  _inside(photo) {
    const heading = this.store.heading(photo.id);
    this.around.show(insideOf(photo, heading), heading === null || this.facing === null ? 0 : this.facing - heading);
    if (this.store.look?.id !== photo.id) this._look();
  }

  _look() {
    const { around, store } = this;
    const heading = store.heading(store.currentId);
    const inside = Boolean(store.current?.panorama);
    if (heading !== null) this.facing = inside ? heading + around.turn : heading;
    store.setLook(inside ? { id: store.currentId, turn: around.turn, fov: around.fov } : null);
  }

  /** The note of the photo on one line (the facts have all of it), and the notes on spots that mention the photo. */
  _notes(photo) {
    const spots = this.store.notes.filter(({ photos }) => photos.includes(photo.id));
    const open = (note) => h("button", { class: "vw-spot", type: "button", onclick: () => noteDialog(this.store, note) }, icon("note"), note.title);
    byId("photo-note").textContent = photo.note ?? "";
    byId("photo-note").title = photo.note ?? "";
    byId("photo-spots").replaceChildren(...spots.map(open));
  }

  /** Load the photo, then those that may be next, of the way and of the steps: one after the other, as they share the network. */
  async _loadAhead(photo) {
    const next = [photo.id, this.walk.after(1), this.walk.after(-1), ...this.walk.steps(photo.id).map(({ id }) => id), this.walk.after(2)];
    for (const id of next) {
      const address = id === null ? null : this.store.photos.get(id)?.preview;
      if (!address) continue;
      const picture = this._load(address);
      if (!picture.complete) await picture.decode().catch(() => {}); // the frame says that it is broken
      if (this.store.currentId !== photo.id) return;
    }
    for (const address of [...this.ahead.keys()].slice(0, -KEPT)) this.ahead.delete(address);
  }

  /** Stop loading any other picture. @param {?string} wanted address of the one that is shown */
  _stopOthers(wanted) {
    for (const [address, picture] of this.ahead) {
      if (address === wanted || picture.complete) continue;
      picture.removeAttribute("src");
      this.ahead.delete(address);
    }
  }

  /** Keep a picture in memory, as the one used last. @param {string} address */
  _load(address) {
    const picture = this.ahead.get(address) ?? Object.assign(new Image(), { src: address });
    this.ahead.delete(address);
    this.ahead.set(address, picture);
    return picture;
  }

  /** A swipe with one finger goes to the next photo, unless the photo is enlarged. */
  _swipe(step) {
    let start = null;
    this.frame.addEventListener("pointerdown", (event) => (start = event.pointerType === "touch" && event.isPrimary && this.zoom.scale === 1 ? [event.clientX, event.clientY] : null));
    this.frame.addEventListener("pointerup", (event) => {
      if (!start || this.zoom.scale > 1) return;
      const [dx, dy] = [event.clientX - start[0], event.clientY - start[1]];
      start = null;
      if (Math.abs(dx) > SWIPE_PX && Math.abs(dx) > 2 * Math.abs(dy)) step(dx < 0 ? 1 : -1);
    });
  }
}
