/** The tray: photos by time with filter and search; one of them is current, some may be selected. */

import { byId, h, icon, queryAll, targetOf } from "../shared/dom.js";
import { clockText } from "../shared/format.js";
import { t, tn } from "../shared/i18n.js";
import { debounce, rafThrottle } from "../shared/timing.js";
import { VirtualList } from "./virtual-list.js";

/** The list of photos, its filters, and the bar for what is selected. */
export class Tray {
  /** @param {import("./commands.js").Commands} commands */
  constructor(commands) {
    this.commands = commands;
    this.store = commands.store;
    this.filter = "unplaced";
    this.search = "";
    this.box = byId("tray-list");
    this.list = new VirtualList(this.box, (id) => this._make(id), (row, id) => this._update(row, id));
    this._listen();
    const render = rafThrottle(() => this.render());
    this.store.on("photos placement selection", render);
    this.store.on("current", () => this._showCurrent());
    this.render();
    this._showCurrent();
  }

  /** Show photos by whether they are placed. @param {string} filter `unplaced`, `placed` or `all` */
  setFilter(filter) {
    this.filter = filter;
    this.box.scrollTop = 0;
    this.render();
    this._showCurrent();
  }

  render() {
    const { store } = this;
    const placed = store.order.filter((id) => store.isPlaced(id)).length;
    const counts = { all: store.order.length, placed, unplaced: store.order.length - placed };
    for (const button of queryAll("[data-filter]", HTMLButtonElement, byId("tray-filter"))) {
      const { filter } = button.dataset;
      button.setAttribute("aria-pressed", String(filter === this.filter));
      button.querySelector("[data-count]").textContent = String(counts[filter]);
    }
    this.list.show(this._ids());
    this._empty(counts);
    this._bar();
  }

  _ids() {
    const { store } = this;
    const wanted = { all: () => true, placed: (id) => store.isPlaced(id), unplaced: (id) => !store.isPlaced(id) };
    const words = this.search.toLowerCase();
    return store.order.filter(
      (id) => wanted[this.filter](id) && (!words || store.photos.get(id).name.toLowerCase().includes(words)),
    );
  }

  _listen() {
    byId("tray-filter").addEventListener("click", (event) => {
      const button = targetOf(event).closest("[data-filter]");
      if (button) this.setFilter(button.getAttribute("data-filter"));
    });
    const search = byId("tray-search", HTMLInputElement);
    search.addEventListener("input", debounce(() => {
      this.search = search.value.trim();
      this.render();
    }, 150));
    this.box.addEventListener("click", (event) => {
      const row = targetOf(event).closest("[data-id]");
      if (row) this._click(Number(row.getAttribute("data-id")), event);
    });
    this.box.addEventListener("keydown", (event) => this._key(event));
    this.box.addEventListener("focus", () => this._activate(this._active ?? this.store.currentId ?? this.list.ids[0]));
    byId("selection-tray", HTMLButtonElement).addEventListener("click", () => this.commands.toTray([...this.store.selection]));
    byId("selection-remove").addEventListener("click", () => this.commands.remove([...this.store.selection]));
    byId("selection-clear").addEventListener("click", () => this.store.setSelection([]));
  }

  _click(id, event) {
    this._activate(id);
    if (event.shiftKey) this._range(id);
    else if (event.ctrlKey || event.metaKey || event.target.closest(".ed-row-check")) this.store.toggleSelected(id);
    else this.store.setCurrent(id);
    if (!event.shiftKey) this._anchor = id;
  }

  /** Select all from the last chosen row to this one. */
  _range(id) {
    const { ids } = this.list;
    const ends = [ids.indexOf(this._anchor ?? this.store.currentId), ids.indexOf(id)].sort((a, b) => a - b);
    this.store.setSelection([...this.store.selection, ...ids.slice(Math.max(ends[0], 0), ends[1] + 1)]);
  }

  _key(event) {
    const { ids, page } = this.list;
    const at = ids.indexOf(this._active);
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, PageDown: at + page, PageUp: at - page, Home: 0, End: ids.length - 1 };
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

  /** The row that keys act on. */
  _activate(id) {
    const row = id === undefined || id === null ? null : this.list.reveal(id);
    const before = this._active;
    this._active = row ? id : null;
    if (row) this.box.setAttribute("aria-activedescendant", row.id);
    else this.box.removeAttribute("aria-activedescendant");
    for (const changed of [before, id]) {
      const shown = this.list.rows.get(changed);
      if (shown) this._update(shown, changed);
    }
  }

  _showCurrent() {
    this.list.render();
    const { currentId } = this.store;
    if (currentId !== null) this._activate(currentId);
  }

  _make(id) {
    return h(
      "div",
      { class: "ed-row", role: "option", id: `photo-${id}`, dataset: { id, testid: "tray-photo" } },
      h("span", { class: "ed-row-check" }, icon("check")),
      h("img", { class: "ed-thumb", alt: "", loading: "lazy", decoding: "async", draggable: "false" }),
      h("span", { class: "ed-row-text" }, h("span", { class: "ed-row-name" }), h("span", { class: "ed-row-time" })),
      h("span", { class: "ed-row-state" }),
    );
  }

  _update(row, id) {
    const { store } = this;
    const photo = store.photos.get(id);
    if (!photo) return;
    const [, image, text, state] = row.children;
    if (photo.thumb && image.getAttribute("src") !== photo.thumb) image.setAttribute("src", photo.thumb);
    const placed = store.isPlaced(id);
    text.children[0].textContent = photo.name;
    text.children[1].textContent = photo.taken_at ? clockText(photo.taken_at) : t("no time");
    if (state.dataset.placed !== String(placed)) state.replaceChildren(placed ? icon("pin") : "");
    state.dataset.placed = String(placed);
    row.setAttribute("aria-selected", String(store.selection.has(id)));
    row.setAttribute("aria-current", String(id === store.currentId));
    row.setAttribute("aria-label", [photo.name, text.children[1].textContent, placed ? t("placed") : t("not placed")].join(", "));
    row.classList.toggle("is-active", id === this._active);
  }

  _empty(counts) {
    const empty = byId("tray-empty");
    empty.hidden = this.list.ids.length > 0;
    if (!empty.hidden) empty.replaceChildren(...this._emptyWords(counts));
  }

  _emptyWords({ all, placed }) {
    if (this.search) return [h("p", {}, t("No photo name matches “{search}”.", { search: this.search }))];
    if (!all) return [h("p", {}, t("No photos yet. Drop a folder anywhere on this page, or choose files."))];
    if (this.filter === "placed") return [h("p", {}, t("No photo is placed yet. Click on the image where the current photo was taken."))];
    const show = () => this.setFilter("placed");
    return [
      h("p", {}, tn("The {n} photo is placed.", "All {n} photos are placed.", placed)),
      h("button", { type: "button", class: "button", onclick: show }, t("Show them")),
    ];
  }

  _bar() {
    const { size } = this.store.selection;
    byId("selection-bar").hidden = size === 0;
    byId("selection-count").textContent = tn("{n} selected", "{n} selected", size);
    byId("selection-tray", HTMLButtonElement).disabled = ![...this.store.selection].some((id) => this.store.isPlaced(id));
  }
}
