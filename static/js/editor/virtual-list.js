/** A list of thousands of rows of one height, of which only those in sight are elements. */

import { h } from "../shared/dom.js";
import { rafThrottle } from "../shared/timing.js";

const OVERSCAN = 12;
/** Short lists are whole, which is kinder to searching in the page. */
const WHOLE = 120;

/** Rows of a listbox. */
export class VirtualList {
  /**
   * @param {HTMLElement} box that scrolls
   * @param {function(number): HTMLElement} make a row for an id
   * @param {function(HTMLElement, number): void} update
   */
  constructor(box, make, update) {
    this.box = box;
    this.make = make;
    this.update = update;
    this.ids = [];
    this.rows = new Map();
    this.space = box.appendChild(h("div", { class: "ed-rows", role: "presentation" }));
    this.render = rafThrottle(() => this._render());
    box.addEventListener("scroll", this.render, { passive: true });
    new ResizeObserver(this.render).observe(box);
  }

  /** @param {number[]} ids in their order */
  show(ids) {
    this.ids = ids;
    this._render();
  }

  /** Scroll a row into sight, and give its element. */
  reveal(id) {
    const at = this.ids.indexOf(id);
    if (at < 0) return null;
    const top = at * this._height();
    const bottom = top + this._height();
    if (top < this.box.scrollTop) this.box.scrollTop = top;
    else if (bottom > this.box.scrollTop + this.box.clientHeight) this.box.scrollTop = bottom - this.box.clientHeight;
    this._render();
    return this.rows.get(id) || null;
  }

  /** Rows that fit into the box. */
  get page() {
    return Math.max(1, Math.floor(this.box.clientHeight / this._height()));
  }

  _height() {
    return parseFloat(getComputedStyle(this.box).getPropertyValue("--row-height")) || 64;
  }

  _render() {
    const height = this._height();
    this.space.style.height = `${this.ids.length * height}px`;
    const { scrollTop, clientHeight } = this.box;
    const all = this.ids.length <= WHOLE;
    const first = all ? 0 : Math.max(0, Math.floor(scrollTop / height) - OVERSCAN);
    const last = all ? this.ids.length : Math.ceil((scrollTop + clientHeight) / height) + OVERSCAN;
    const wanted = this.ids.slice(first, last);
    const keep = new Set(wanted);
    for (const [id, row] of this.rows) {
      if (keep.has(id)) continue;
      row.remove();
      this.rows.delete(id);
    }
    wanted.forEach((id, n) => this._row(id, first + n, height));
  }

  _row(id, at, height) {
    let row = this.rows.get(id);
    if (!row) {
      row = this.make(id);
      this.rows.set(id, row);
      this.space.append(row);
    }
    row.style.transform = `translateY(${at * height}px)`;
    row.setAttribute("aria-posinset", at + 1);
    row.setAttribute("aria-setsize", this.ids.length);
    this.update(row, id);
  }
}
