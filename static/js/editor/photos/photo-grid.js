/** The photos as a grid: one is current, some may be selected, and they can be dragged to the image. */

import { byId, h, icon, queryAll, targetOf } from "../../shared/dom.js";
import { accuracyText, clockText, offText } from "../../shared/format.js";
import { labelled, t, tn } from "../../shared/i18n.js";
import { afterPaint } from "../../shared/timing.js";
import { PHOTOS_TYPE } from "./drop-photos.js";
import { VirtualGrid } from "../../shared/virtual-grid.js";

/** The grid, and the filter for placed or unplaced photos. */
export class PhotoGrid {
  /**
   * @param {import("../commands.js").Commands} commands
   * @param {import("./photo-order.js").PhotoOrder} order
   * @param {{open: function(): void, menu: function(number, {x: number, y: number}): void}} on double click; right click
   */
  constructor(commands, order, on) {
    this.commands = commands;
    this.order = order;
    this.store = commands.store;
    this.on = on;
    this.box = byId("tray-list");
    this.grid = new VirtualGrid(this.box, (id) => this._make(id), (tile, id) => this._update(tile, id), () => this._nameActive());
    this._listen();
    this.store.on("photos placement selection", afterPaint(() => this.render()));
    this.store.on("current", afterPaint(() => this._showCurrent()));
    const reorder = afterPaint(() => {
      this.box.scrollTo(0, 0);
      this.render({ reveal: this.store.currentId });
      this._showCurrent();
    });
    order.addEventListener("change", () => {
      this._press();
      reorder();
    });
    this._press();
    this.render();
    this._showCurrent();
  }

  /** @param {{reveal?: ?number}} [options] `reveal`: id of a photo to scroll to, if it is shown */
  render({ reveal = null } = {}) {
    const { store } = this;
    const unplaced = store.unplaced().length;
    const counts = { all: store.order.length, placed: store.order.length - unplaced, unplaced };
    for (const button of this._filters) {
      const count = button.querySelector("[data-count]");
      count.textContent = String(counts[button.dataset.filter]);
      count.toggleAttribute("hidden", !counts[button.dataset.filter]);
    }
    this.grid.show(this.order.shown(), reveal);
    this._empty(counts);
    this._withoutGps();
  }

  get _filters() {
    return queryAll("[data-filter]", HTMLButtonElement, byId("tray-filter"));
  }

  /** Show which filter is chosen. */
  _press() {
    for (const button of this._filters) button.setAttribute("aria-pressed", String(button.dataset.filter === this.order.place));
  }

  _listen() {
    byId("tray-filter").addEventListener("click", (event) => {
      const button = /** @type {?HTMLElement} */ (targetOf(event).closest("[data-filter]"));
      if (button) this.order.show(/** @type {*} */ (button.dataset.filter));
    });
    const { box } = this;
    box.addEventListener("click", (event) => this._at(event, (id) => this._click(id, event)));
    box.addEventListener("dblclick", (event) => this._at(event, () => this.on.open()));
    box.addEventListener("contextmenu", (event) => this._menu(event));
    box.addEventListener("dragstart", (event) => this._at(event, (id) => this._drag(id, event)));
    box.addEventListener("keydown", (event) => this._key(event));
    box.addEventListener("focus", () => this._activate(this._active ?? this.store.currentId ?? this.grid.ids[0]));
  }

  /** Call a function with the photo under an event. */
  _at(event, run) {
    const tile = targetOf(event).closest("[data-id]");
    if (tile) run(Number(tile.getAttribute("data-id")));
  }

  _click(id, event) {
    this._activate(id);
    if (event.shiftKey) this._range(id);
    else if (event.ctrlKey || event.metaKey || event.target.closest(".ed-tile__check")) this.store.toggleSelected(id);
    else this.store.setCurrent(id);
    if (!event.shiftKey) this._anchor = id;
  }

  /** Open the menu of the photo under the mouse or, by the keyboard, of the active one. */
  _menu(event) {
    event.preventDefault();
    const byKey = !targetOf(event).closest("[data-id]");
    if (!byKey) this._at(event, (id) => this.on.menu(id, { x: event.clientX, y: event.clientY }));
    else if (this.grid.tiles.has(this._active)) {
      const { left, bottom } = this.grid.tiles.get(this._active).getBoundingClientRect();
      this.on.menu(this._active, { x: left, y: bottom });
    }
  }

  /** Dragging a selected photo drags the whole selection. */
  _drag(id, event) {
    const { selection } = this.store;
    event.dataTransfer.setData(PHOTOS_TYPE, JSON.stringify(selection.has(id) ? [...selection] : [id]));
    event.dataTransfer.effectAllowed = "move";
    const { width, height } = event.target.getBoundingClientRect();
    event.dataTransfer.setDragImage(event.target.querySelector("img"), width / 2, height / 2);
  }

  /** Select all from the last chosen photo to this one. */
  _range(id) {
    const { ids } = this.grid;
    const ends = [ids.indexOf(this._anchor ?? this.store.currentId), ids.indexOf(id)].sort((a, b) => a - b);
    this.store.setSelection([...this.store.selection, ...ids.slice(Math.max(ends[0], 0), ends[1] + 1)]);
  }

  _key(event) {
    const { ids, steps: { across, page } } = this.grid;
    const at = ids.indexOf(this._active);
    const to = {
      ArrowRight: at + 1, ArrowLeft: at - 1, ArrowDown: at + across, ArrowUp: at - across,
      PageDown: at + page, PageUp: at - page, Home: 0, End: ids.length - 1,
    };
    if (event.key in to) {
      const id = ids[Math.min(Math.max(to[event.key], 0), ids.length - 1)];
      if (event.shiftKey && id !== undefined) this.store.setSelection([...this.store.selection, this._active, id]);
      this._activate(id);
    } else if (event.key === "Enter" && at >= 0) this.store.setCurrent(this._active);
    else if (event.key === " " && at >= 0) this.store.toggleSelected(this._active);
    else if (event.key.toLowerCase() === "a" && (event.ctrlKey || event.metaKey)) this.store.setSelection(ids);
    else return;
    event.preventDefault();
    event.stopPropagation();
  }

  /** Make a photo the one that keys act on. */
  _activate(id) {
    const tile = id === undefined || id === null ? null : this.grid.reveal(id);
    const before = this._active;
    this._active = tile ? id : null;
    this._nameActive();
    for (const changed of [before, id]) {
      const shown = this.grid.tiles.get(changed);
      if (shown) this._update(shown, changed);
    }
  }

  /** Set `aria-activedescendant` only while the active photo has an element: tiles out of view are removed. */
  _nameActive() {
    const tile = this.grid.tiles.get(this._active);
    if (tile) this.box.setAttribute("aria-activedescendant", tile.id);
    else this.box.removeAttribute("aria-activedescendant");
  }

  _showCurrent() {
    this.grid.render();
    const { currentId } = this.store;
    if (currentId !== null) this._activate(currentId);
  }

  _make(id) {
    return h(
      "div",
      { class: "ed-tile", role: "option", id: `photo-${id}`, dataset: { id, testid: "tray-photo" }, draggable: String(this.store.canEdit) },
      h("img", { class: "ed-thumb", alt: "", loading: "lazy", decoding: "async", draggable: "false" }),
      h("span", { class: "ed-tile__check" }, icon("check")),
      h("span", { class: "ed-tile__placed ed-badge" }, icon("pin")),
      h("span", { class: "ed-tile__badges", "aria-hidden": "true" }),
      h("span", { class: "ed-tile__name" }),
      h("span", { class: "visually-hidden" }),
    );
  }

  _update(tile, id) {
    const { store } = this;
    const photo = store.photos.get(id);
    if (!photo) return;
    const [image, , pin, badges, name, details] = tile.children;
    if (photo.thumb && image.getAttribute("src") !== photo.thumb) image.setAttribute("src", photo.thumb);
    name.textContent = photo.name;
    const facts = factsOf(store, id);
    const placed = store.isPlaced(id);
    pin.toggleAttribute("hidden", !placed);
    const signature = JSON.stringify(facts);
    if (badges.dataset.facts !== signature) badges.replaceChildren(...facts.map(badge));
    badges.dataset.facts = signature;
    tile.setAttribute("aria-selected", String(store.selection.has(id)));
    tile.setAttribute("aria-current", String(id === store.currentId));
    const words = ["", photo.taken_at ? clockText(photo.taken_at) : t("no time"), placed ? t("placed") : t("not placed"), ...facts.map((fact) => fact.words)];
    details.textContent = words.join(", ");
    name.title = photo.name;
    tile.classList.toggle("is-active", id === this._active);
  }

  _empty(counts) {
    const empty = byId("tray-empty");
    empty.hidden = this.grid.ids.length > 0;
    if (!empty.hidden) empty.replaceChildren(...this._emptyWords(counts));
  }

  /** Show why photos in the tray have no GPS position, grouped by reason. */
  _withoutGps() {
    const { store } = this;
    const reasons = new Map();
    for (const id of store.unplaced()) {
      const { gps, gps_problem: problem } = store.photos.get(id);
      if (!gps && problem) reasons.set(problem, (reasons.get(problem) ?? 0) + 1);
    }
    const box = byId("tray-gps", HTMLDetailsElement);
    const count = [...reasons.values()].reduce((sum, n) => sum + n, 0);
    box.hidden = !count || this.order.place === "placed";
    byId("tray-gps-count").textContent = tn("{n} photo has no GPS position", "{n} photos have no GPS position", count);
    byId("tray-gps-why").replaceChildren(...[...reasons].map(([reason, n]) =>
      h("li", {}, labelled(tn("{n} photo", "{n} photos", n), reason))));
  }

  _emptyWords({ all, placed, unplaced }) {
    const { filters, active, place } = this.order;
    if (!all) return [h("p", {}, t("No photos yet. Drop a folder anywhere on this page, or choose files."))];
    if (filters.text && !active) return [h("p", {}, t("No photo name matches “{search}”.", { search: filters.text }))];
    if (active) return [h("p", {}, t("No photo passes the filters.")), this._button(t("Clear the filters"), () => this.order.clear())];
    if (place === "placed") return [h("p", {}, t("No photo is placed yet. Click on the image where the current photo was taken."))];
    if (unplaced) return [];
    return [h("p", {}, tn("The {n} photo is placed.", "All {n} photos are placed.", placed)), this._button(t("Show them"), () => this.order.show("placed"))];
  }

  _button(words, onclick) {
    return h("button", { type: "button", class: "button", onclick }, words);
  }
}

/** @typedef {{icon: string, text: string, words: string, turn?: number}} Fact */

/** Facts about a photo for its badges, with their texts. @returns {Fact[]} */
function factsOf(store, id) {
  const { gps } = store.photos.get(id);
  const radius = store.radius(id);
  const off = radius === null ? null : offText(radius, store.georeference.metresPerPixel);
  const accuracy = off === null && gps?.accuracy_m ? `±${accuracyText(gps.accuracy_m)}` : "";
  const heading = store.heading(id);
  return [
    off !== null && { icon: "pin", text: `±${off}`, words: t("Placed as suggested, within {distance}", { distance: off }) },
    gps && { icon: "target", text: accuracy, words: ["GPS", accuracy].filter(Boolean).join(" ") },
    heading !== null && { icon: "north", text: "", words: t("Heading {degrees}°", { degrees: Math.round(heading) }), turn: heading },
  ].filter(Boolean);
}

/** @param {Fact} fact */
function badge({ icon: name, text, turn }) {
  const drawn = icon(name);
  if (turn !== undefined) drawn.style.rotate = `${Math.round(turn)}deg`;
  return h("span", { class: "ed-badge" }, drawn, text);
}
