/** Notes at positions on the map, edited in a dialog and moved by dragging their markers. */

import { busy, errorLine, field, openDialog } from "../shared/dialogs.js";
import { byId, h, icon } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { clamped, pixelOf } from "../shared/map/coords.js";
import { floorSelect } from "../shared/map/floor-switch.js";
import { NoteLayer, noteDialog, notePhotos } from "../shared/map/note-layer.js";
import { toastError } from "../shared/toast.js";

const MOST_TITLE = 120;
const MOST_TEXT = 4000;

/** The notes of the page. */
export class Notes {
  /** @param {Object} page store, server and view */
  constructor({ store, server, view }) {
    this.store = store;
    this.server = server;
    this.view = view;
    this._own = 0; // revision of the last change made on this page
    const moved = (note, at) => this._send(() => server.changeNote({ ...note, x_px: at[0], y_px: at[1] }, this._seen));
    new NoteLayer(store, view.map, store.canEdit ? { open: (note) => this.edit(note), moved } : { open: (note) => noteDialog(store, note) });
    byId("note-button").addEventListener("click", () => {
        if (store.satellite) this.add(clamped(pixelOf(view.map.getCenter()), store.satellite));
    });
  }

  /** Write a new note. @param {number[]} at map pixel */
  add([x_px, y_px]) {
    this.edit({ id: null, title: "", text: "", x_px, y_px, photos: [...this.store.selection], floor: this.store.floor });
  }

  /** The newest revision whose notes are known, so that a later change by someone else is not overwritten. */
  get _seen() {
    return Math.max(this.store.revision, this._own);
  }

  /** @param {Object} note */
  edit(note) {
    const seen = this._seen;
    const title = h("input", { class: "input", value: note.title, maxlength: MOST_TITLE, autocomplete: "off", "data-testid": "note-title" });
    const text = h("textarea", { class: "input note-input", rows: 5, maxlength: MOST_TEXT, "data-testid": "note-text" }, note.text);
    const about = h("input", { type: "checkbox", checked: note.photos.length > 0 });
    const photos = note.photos.length ? note.photos : [...this.store.selection];
    const linked = photos.length > 0 && h("label", { class: "check small" }, about, tn("About {n} photo", "About {n} photos", photos.length));
    const error = errorLine();
    const save = h("button", { class: "button button--primary", type: "button", "data-testid": "note-save" }, t("Save"));
    const remove = note.id !== null && h("button", { class: "button", type: "button", "data-testid": "note-remove" }, icon("trash"), t("Remove"));
    const floor = this.store.floors.length > 0 && floorSelect(this.store.floors, note.floor);
    const body = [field(t("Title"), title), field(t("Text"), text), floor && field(t("Floor"), floor), linked, notePhotos(this.store, note.photos), error].filter(Boolean);
    const dialog = openDialog(note.id === null ? t("New note") : t("Note"), body, { actions: [remove, save].filter(Boolean) });
    const done = (button, run) => button.addEventListener("click", () => busy(button, async () => {
      try {
        this._merge(await run());
        dialog.close();
      } catch (problem) {
        error.show(problem);
      }
    }));
    const wish = () => ({
      ...note, title: title.value.trim(), text: text.value.trim(), photos: about.checked ? photos : [], ...(floor && { floor: Number(floor.value) }),
    });
    done(save, () => (note.id === null ? this.server.addNote(wish()) : this.server.changeNote(wish(), seen)));
    if (remove) done(remove, () => this.server.removeNote(note.id, seen));
    title.focus();
  }

  _merge(answer) {
    this._own = Math.max(this._own, answer.revision ?? 0);
    this.store.merge(answer);
  }

  async _send(run) {
    try {
      this._merge(await run());
    } catch (error) {
      this.store.emit("notes");
      toastError(error);
    }
  }
}
