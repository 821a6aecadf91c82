/** The table of objects: filter by class and text, sort by column, select one to see it on the map. */

import { byId, h, queryAll, targetOf } from "../shared/dom.js";
import { locale, t, tn } from "../shared/i18n.js";
import { debounce, rafThrottle } from "../shared/timing.js";
import { toastError } from "../shared/toast.js";
import { clockText, DAY_S, timeText } from "./format.js";

const PAGE = 500;
const MOST = 5000;
const ROWS = 200;
const CALM_MS = 150;
const NAMES = new Intl.Collator(locale, { numeric: true });
const VALUES = {
  id: (object) => object.id,
  kind: (object) => object.kind,
  last: (object) => object.last_time_s,
  confidence: (object) => object.confidence ?? -1,
};

/** Table, filter and sort order; the filter also applies to the map. */
export class ObjectTable {
  /**
   * @param {import("./mission-store.js").MissionStore} store
   * @param {function(Object): void} look called with the object chosen here
   */
  constructor(store, look) {
    this.store = store;
    this.look = look;
    this.sort = { by: "last", down: true };
    this.rows = ROWS;
    this.asked = new Set();
    this.words = byId("object-words", HTMLInputElement);
    this.kind = byId("object-kind", HTMLSelectElement);
    this.body = byId("objects");
    this.render = rafThrottle(() => this._render());
    this.words.addEventListener("input", debounce(() => this._filter(), CALM_MS));
    this.kind.addEventListener("change", () => this._filter());
    byId("objects-more").addEventListener("click", () => {
      this.rows += ROWS;
      this.render();
    });
    for (const button of queryAll("[data-sort]", HTMLButtonElement)) button.addEventListener("click", () => this._sortBy(button.dataset.sort));
    this.body.addEventListener("click", (event) => {
      const key = targetOf(event).closest("tr")?.dataset.key;
      if (key) this._choose(key);
    });
    store.on("missions", () => this._load());
    store.on("objects", () => this._filter());
    store.on("chosen", this.render);
    this._load();
    this.render();
  }

  /** Load the objects of missions that were not loaded yet. */
  async _load() {
    for (const mission of this.store.missions.values()) {
      if (this.asked.has(mission.id) || !mission.objects) continue;
      this.asked.add(mission.id);
      await this._all(mission).catch(toastError);
    }
    for (const id of this.asked) if (!this.store.missions.has(id)) this.asked.delete(id);
  }

  async _all({ id }) {
    for (let offset = 0; offset < MOST; offset += PAGE) {
      const { objects } = await this.store.server(id).objects({ limit: PAGE, offset });
      this.store.setObjects(id, objects);
      if (objects.length < PAGE) return;
    }
  }

  _sortBy(by) {
    const down = this.sort.by === by ? !this.sort.down : by === "last" || by === "confidence";
    this.sort = { by, down };
    this._render();
  }

  _filter() {
    this._kinds();
    const words = this.words.value.trim().toLowerCase();
    const kind = this.kind.value;
    if (!words && !kind) this.store.setMatching(null);
    else {
      const fits = (object) => (!kind || object.kind === kind) && `${object.id} ${object.kind}`.toLowerCase().includes(words);
      this.store.setMatching(new Set([...this.store.objects.values()].filter(fits).map(({ key }) => key)));
    }
    this.render();
  }

  _kinds() {
    const kinds = [...new Set([...this.store.objects.values()].map(({ kind }) => kind))].sort(NAMES.compare);
    const known = [...this.kind.options].slice(1).map(({ value }) => value);
    if (kinds.join("\n") === known.join("\n")) return;
    const chosen = this.kind.value;
    this.kind.replaceChildren(h("option", { value: "" }, t("All classes")), ...kinds.map((kind) => h("option", { value: kind }, kind)));
    this.kind.value = kinds.includes(chosen) ? chosen : "";
  }

  _render() {
    const { store, sort } = this;
    this.oneDay = store.clock && !store.clock.aligned && store.clock.span < DAY_S;
    const matching = [...store.objects.values()].filter(({ key }) => !store.matching || store.matching.has(key));
    const value = VALUES[sort.by];
    const compare = (a, b) => (typeof value(a) === "string" ? NAMES.compare(value(a), value(b)) : value(a) - value(b));
    matching.sort((a, b) => (sort.down ? -compare(a, b) : compare(a, b)) || NAMES.compare(a.id, b.id));
    for (const button of queryAll("[data-sort]", HTMLButtonElement)) {
      const mine = button.dataset.sort === sort.by;
      button.closest("th").setAttribute("aria-sort", mine ? (sort.down ? "descending" : "ascending") : "none");
    }
    const focused = document.activeElement?.closest("#objects tr")?.getAttribute("data-key");
    this.body.replaceChildren(...matching.slice(0, this.rows).map((object) => this._row(object)));
    if (focused) queryAll(`tr[data-key="${CSS.escape(focused)}"] button`, HTMLButtonElement, this.body)[0]?.focus();
    this._showCount(matching.length);
  }

  _row(object) {
    const { key, id, kind, last_time_s: last, confidence } = object;
    const chosen = key === this.store.chosen;
    return h("tr", { dataset: { key }, "data-testid": "object", class: chosen ? "is-chosen" : null },
      h("td", {}, h("button", { class: "mi-object", type: "button", "aria-pressed": String(chosen) }, this.store.symbols.element(kind), id)),
      h("td", {}, kind),
      h("td", { class: "number" }, h("time", { datetime: new Date(last * 1000).toISOString(), title: clockText(last) }, this.oneDay ? timeText(last) : clockText(last))),
      h("td", { class: "number" }, confidence === null || confidence === undefined ? "" : `${Math.round(confidence * 100)}\u00a0%`));
  }

  _showCount(matching) {
    const { size } = this.store.objects;
    byId("objects-none").hidden = size > 0;
    byId("objects-part").hidden = size === 0;
    byId("objects-count").textContent = matching === size
      ? tn("{n} object", "{n} objects", size)
      : t("{n} of {all}", { n: matching.toLocaleString(locale), all: size.toLocaleString(locale) });
    byId("objects-more").hidden = matching <= this.rows;
    byId("tab-objects-count").textContent = size ? size.toLocaleString(locale) : "";
  }

  _choose(key) {
    const object = this.store.objects.get(key);
    this.store.choose(key);
    if (object) this.look(object);
  }
}
