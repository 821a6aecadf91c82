/** Notes at positions on the map: markers that open their text. */

import { openDialog } from "../dialogs.js";
import { h, icon } from "../dom.js";
import { t } from "../i18n.js";
import { latLngOf, pixelOf } from "./coords.js";

const SIDE = 30;

/** @typedef {Required<Api["NoteOut"]>} Note */

/** A Leaflet layer with a marker for each note on the floor that is shown; follows the store. */
export class NoteLayer {
  /**
   * @param {import("./map-store.js").MapStore} store
   * @param {L.Map} map
   * @param {{open?: function(Note): void, moved?: function(Note, number[]): void}} [does] with `moved`, markers can be dragged
   */
  constructor(store, map, { open = (note) => noteDialog(store, note), moved } = {}) {
    this.store = store;
    this.open = open;
    this.moved = moved;
    this.group = L.layerGroup().addTo(map);
    /** @type {Map<number, L.Marker>} by the ids of the notes */
    this.marks = new Map();
    this.dragged = null;
    store.on("notes satellite floor", () => this.show());
    this.show();
  }

  /** Update the markers. The element of a note is kept: it may have the focus or be under a finger. */
  show() {
    const { floors, floor } = this.store;
    const notes = this.store.notes.filter((note) => note.x_px !== null && (!floors.length || note.floor === floor));
    for (const [id, mark] of this.marks) {
      if (notes.some((note) => note.id === id)) continue;
      mark.remove();
      this.marks.delete(id);
    }
    for (const note of notes) {
      if (!this.marks.has(note.id)) this.marks.set(note.id, this._mark(note).addTo(this.group));
      const mark = this.marks.get(note.id);
      mark.options.title = note.title;
      mark.getElement()?.setAttribute("title", note.title);
      if (mark !== this.dragged) mark.setLatLng(latLngOf([note.x_px, note.y_px]));
    }
  }

  _mark({ id, x_px: x, y_px: y }) {
    const html = h("span", { class: "note-mark__face" }, icon("note"));
    const look = L.divIcon({ className: "note-mark", html, iconSize: [SIDE, SIDE], iconAnchor: [SIDE / 2, SIDE - 2] });
    const mark = L.marker(latLngOf([x, y]), { icon: look, draggable: Boolean(this.moved), zIndexOffset: 500 });
    const note = () => this.store.notes.find((one) => one.id === id);
    mark.on("click", (event) => {
      L.DomEvent.stop(event);
      this.open(note());
    });
    mark.on("keypress", ({ originalEvent }) => {
      if (originalEvent.key !== "Enter" && originalEvent.key !== " ") return;
      originalEvent.preventDefault(); // a space would scroll the page
      this.open(note());
    });
    mark.on("dragstart", () => (this.dragged = mark));
    mark.on("dragend", () => {
      this.dragged = null;
      if (note()) this.moved(note(), pixelOf(mark.getLatLng())); // unless it was deleted meanwhile
    });
    return mark;
  }
}

/** Show a note for reading. @param {import("./map-store.js").MapStore} store @param {Note} note */
export function noteDialog(store, note) {
  openDialog(note.title, [note.text && h("p", { class: "note-text" }, note.text), notePhotos(store, note.photos)].filter(Boolean));
}

/** Pictures of the photos that a note is about. @param {import("./map-store.js").MapStore} store @param {number[]} ids */
export function notePhotos(store, ids) {
  const there = ids.map((id) => store.photos.get(id)).filter((photo) => photo?.thumb);
  if (!there.length) return null;
  const picture = ({ id, thumb, name }) => {
    const choose = (event) => {
      event.target.closest("dialog").close();
      store.setCurrent(id);
    };
    const words = name || t("Photo {id}", { id });
    return h("button", { class: "note-photo", type: "button", title: words, onclick: choose }, h("img", { src: thumb, alt: words, loading: "lazy" }));
  };
  return h("div", { class: "note-photos" }, ...there.map(picture));
}
