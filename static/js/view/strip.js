/** The filmstrip along the way, and the choice of its order, day and camera. */

import { byId, h, queryAll } from "../shared/dom.js";
import { clockText } from "../shared/format.js";
import { locale, t } from "../shared/i18n.js";
import { rafThrottle } from "../shared/timing.js";
import { VirtualGrid } from "../shared/virtual-grid.js";
import { writeOrder } from "./address.js";
import { dayOf } from "./walk.js";

const day = new Intl.DateTimeFormat(locale, { dateStyle: "medium", timeZone: "UTC" });
const shortDay = new Intl.DateTimeFormat(locale, { day: "numeric", month: "short", timeZone: "UTC" });
const clock = new Intl.DateTimeFormat(locale, { timeStyle: "short", timeZone: "UTC" });

/** Follows the store and the walk. */
export class Strip {
  /** @param {import("./walk.js").Walk} walk @param {HTMLImageElement} image the current photo, which loads before those of the strip @param {function(number): void} go */
  constructor(walk, image, go) {
    this.walk = walk;
    this.store = walk.store;
    this.image = image;
    this.box = byId("strip");
    this.orders = queryAll("[data-order]", HTMLButtonElement, byId("orders"));
    this.grid = new VirtualGrid(this.box, (id) => this._make(id), (tile, id) => this._update(tile, id), () => this._active());
    this.box.addEventListener("click", (event) => {
      const tile = /** @type {?HTMLElement} */ (/** @type {HTMLElement} */ (event.target).closest("[data-id]"));
      if (tile) go(Number(tile.dataset.id));
    });
    this._choices();
    const render = rafThrottle(() => this.render());
    walk.addEventListener("change", render);
    this.store.on("current", () => this._current());
    for (const end of ["load", "error"]) image.addEventListener(end, () => this.grid.render());
    this.render();
  }

  render() {
    for (const button of this.orders) button.setAttribute("aria-pressed", String(button.dataset.order === this.walk.order));
    fill(byId("day", HTMLSelectElement), t("All days"), this.walk.days(), (iso) => day.format(new Date(iso)));
    fill(byId("camera", HTMLSelectElement), t("All cameras"), this.walk.cameras(), (name) => name);
    this.grid.show(this.walk.ids);
    this._current();
  }

  _choices() {
    const { walk, orders } = this;
    byId("orders").hidden = !walk.hasTimes;
    for (const button of orders) {
      button.addEventListener("click", () => {
        const order = /** @type {*} */ (button.dataset.order);
        writeOrder(order);
        walk.choose({ order });
      });
    }
    for (const name of ["day", "camera"]) {
      const select = byId(name, HTMLSelectElement);
      select.addEventListener("change", () => walk.choose({ [name]: select.value }));
    }
  }

  _current() {
    const { ids } = this.walk;
    const at = ids.indexOf(this.store.currentId);
    byId("place-in-order").textContent = t("{n} of {count}", { n: at < 0 ? "–" : (at + 1).toLocaleString(locale), count: ids.length.toLocaleString(locale) });
    byId("photo-previous", HTMLButtonElement).disabled = this.walk.after(-1) === null;
    byId("photo-next", HTMLButtonElement).disabled = this.walk.after(1) === null;
    for (const near of at < 0 ? [] : [at - 1, at + 1, at]) this.grid.reveal(ids[near]);
    this.grid.render();
  }

  _make(id) {
    return h("div", { class: "vw-tile", role: "option", id: `tile-${id}`, dataset: { id } }, h("img", { alt: "", draggable: "false" }), h("span", { class: "vw-tile__words number" }));
  }

  _update(tile, id) {
    const photo = this.store.photos.get(id);
    const image = tile.querySelector("img");
    if (photo.thumb && this.image.complete && image.getAttribute("src") !== photo.thumb) image.src = photo.thumb;
    const at = this.walk.ids.indexOf(id);
    const before = this.store.photos.get(this.walk.ids[at - 1]);
    const begins = Boolean(dayOf(photo)) && (!before || dayOf(before) !== dayOf(photo));
    tile.classList.toggle("begins", begins);
    const words = begins ? shortDay.format(new Date(dayOf(photo))) : timeText(photo) || photo.name || (at + 1).toLocaleString(locale);
    tile.querySelector("span").textContent = words;
    tile.setAttribute("aria-label", [...new Set([words, photo.name, photo.taken_at && clockText(photo.taken_at)])].filter(Boolean).join(", "));
    tile.setAttribute("aria-selected", String(id === this.store.currentId));
  }

  _active() {
    const { currentId } = this.store;
    if (this.grid.tiles.has(currentId)) this.box.setAttribute("aria-activedescendant", `tile-${currentId}`);
    else this.box.removeAttribute("aria-activedescendant");
  }
}

/** The time of day as the camera's clock showed it. */
function timeText({ taken_at: iso }) {
  const parsed = new Date(`${iso?.slice(0, 19)}Z`);
  return Number.isNaN(parsed.getTime()) ? "" : clock.format(parsed);
}

/** Fill a choice, which is hidden where there is nothing to choose. @param {HTMLSelectElement} select @param {string} every @param {Map<string, number>} counts @param {function(string): string} words */
function fill(select, every, counts, words) {
  const chosen = select.value;
  const options = [...counts].map(([value, count]) => h("option", { value }, `${words(value)} (${count.toLocaleString(locale)})`));
  select.replaceChildren(h("option", { value: "" }, every), ...options);
  select.value = counts.has(chosen) ? chosen : "";
  select.hidden = counts.size < 2;
}
