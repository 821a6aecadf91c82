/** A grid of thousands of equal tiles, with elements only for those in or near the view. */

import { h } from "./dom.js";
import { rafThrottle } from "./timing.js";

const EDGE = 8;
const GAP = 6;
/** Aspect ratio of a photo, above its name. */
const SHAPE = 4 / 3;
/** Rows rendered beyond the visible ones. */
const OVERSCAN = 2;

/**
 * Layout of the tiles: columns of a minimum width, or one row as high as the box.
 * @param {{width: number, height: number}} box
 * @param {{count: number, least: number, label: number, strip: boolean}} tiles `least` width; `label`: height of the name
 * @returns {{columns: number, tile: [number, number], step: [number, number], size: [number, number]}} pixels
 */
export function gridLayout(box, { count, least, label, strip }) {
  if (strip) {
    const high = Math.max(box.height - 2 * EDGE, label + 30);
    const wide = Math.round((high - label) * SHAPE);
    return { columns: Math.max(count, 1), tile: [wide, high], step: [wide + GAP, high + GAP], size: [2 * EDGE + count * (wide + GAP), box.height] };
  }
  const room = Math.max(box.width - 2 * EDGE, least);
  const columns = Math.max(1, Math.floor((room + GAP) / (least + GAP)));
  const wide = (room + GAP) / columns - GAP;
  const high = Math.round(wide / SHAPE) + label;
  const rows = Math.ceil(count / columns);
  return { columns, tile: [wide, high], step: [wide + GAP, high + GAP], size: [box.width, 2 * EDGE + rows * (high + GAP)] };
}

/**
 * Range of tiles in or near the view.
 * @param {{columns: number, step: number[]}} layout
 * @param {{left: number, top: number, width: number, height: number}} sight the part of the grid that the box shows
 * @param {{count: number, strip: boolean}} tiles
 * @returns {[number, number]} first, and last + 1
 */
export function inSight({ columns, step }, sight, { count, strip }) {
  const [start, length, size] = strip ? [sight.left, sight.width, step[0]] : [sight.top, sight.height, step[1]];
  const across = strip ? 1 : columns;
  const first = Math.max(0, Math.floor(start / size) - OVERSCAN) * across;
  return [first, Math.min(count, (Math.ceil((start + length) / size) + OVERSCAN) * across)];
}

/** Tiles of a listbox. */
export class VirtualGrid {
  /**
   * @param {HTMLElement} box scrolling element; its class `is-strip` makes one row, its `--tile` is the minimum width of a tile
   * @param {function(number): HTMLElement} make a tile for an id
   * @param {function(HTMLElement, number): void} update
   * @param {function(): void} rendered called after each rendering
   */
  constructor(box, make, update, rendered) {
    this.rendered = rendered;
    this.box = box;
    this.make = make;
    this.update = update;
    this.ids = [];
    this.tiles = new Map();
    this.space = box.appendChild(h("div", { class: "ed-tiles", role: "presentation" }));
    this.render = rafThrottle(() => this._render());
    box.addEventListener("scroll", this.render, { passive: true });
    new ResizeObserver(() => this._resize()).observe(box);
    this._measure();
    this._shown = this._view();
  }

  /** @param {number[]} ids in their order @param {?number} [reveal] id of a tile to scroll into view */
  show(ids, reveal = null) {
    this.ids = ids;
    this._measure();
    this._scrollTo(ids.indexOf(reveal));
    this._shown = this._view();
    this._render();
  }

  /** Scroll a tile into view and return its element. */
  reveal(id) {
    const at = this.ids.indexOf(id);
    if (at < 0) return null;
    if (this._scrollTo(at) || !this.tiles.has(id)) this._render();
    return this.tiles.get(id) || null;
  }

  /** Scroll a tile into view; return whether the view moved. @param {number} at its number, or -1 for none */
  _scrollTo(at) {
    if (at < 0) return false;
    const [x, y] = this._corner(at);
    const { scrollLeft, scrollTop, clientWidth, clientHeight } = this.box;
    this._scroll("scrollLeft", x - EDGE, x + this.layout.step[0], clientWidth, this.strip);
    this._scroll("scrollTop", y - EDGE, y + this.layout.step[1], clientHeight, !this.strip);
    return this.box.scrollLeft !== scrollLeft || this.box.scrollTop !== scrollTop;
  }

  get strip() {
    return this.box.classList.contains("is-strip");
  }

  /** Tiles that a key moves by: `across` for vertical arrows, `page` for the page keys. */
  get steps() {
    const { columns, step } = this.layout;
    const { clientWidth, clientHeight } = this.box;
    if (this.strip) return { across: 1, page: Math.max(1, Math.floor(clientWidth / step[0])) };
    return { across: columns, page: columns * Math.max(1, Math.floor(clientHeight / step[1])) };
  }

  _scroll(side, start, end, length, scrolls) {
    if (!scrolls) return;
    if (start < this.box[side]) this.box[side] = start;
    else if (end > this.box[side] + length) this.box[side] = end - length;
  }

  _measure() {
    const style = getComputedStyle(this.box);
    const number = (name) => parseFloat(style.getPropertyValue(name));
    const { clientWidth: width, clientHeight: height } = this.box;
    const tiles = { count: this.ids.length, least: number("--tile"), label: number("--tile-label"), strip: this.strip };
    this.layout = gridLayout({ width, height }, tiles);
    const [wide, high] = this.layout.tile;
    const [all, tall] = this.layout.size;
    Object.assign(this.space.style, { width: `${all}px`, height: `${tall}px` });
    this.space.style.setProperty("--wide", `${wide}px`);
    this.space.style.setProperty("--high", `${high}px`);
  }

  /** Size and shape of the box that the layout depends on. */
  _view() {
    const { clientWidth: width, clientHeight: height } = this.box;
    return { width, height, strip: this.strip };
  }

  /** Keep the first visible tile in view. */
  _resize() {
    const [now, shown] = [this._view(), this._shown];
    if (!now.width) return; // hidden
    if (now.width === shown.width && now.height === shown.height && now.strip === shown.strip) return; // shown again
    const { columns, step } = this.layout;
    const first = shown.strip ? Math.round(this.box.scrollLeft / step[0]) : Math.round(this.box.scrollTop / step[1]) * columns;
    this._measure();
    this._shown = now;
    const [x, y] = this._corner(Math.min(first, Math.max(this.ids.length - 1, 0)));
    this.box.scrollLeft = this.strip ? x - EDGE : 0;
    this.box.scrollTop = this.strip ? 0 : y - EDGE;
    this._render();
  }

  _corner(at) {
    const { columns, step } = this.layout;
    return [EDGE + (at % columns) * step[0], EDGE + Math.floor(at / columns) * step[1]];
  }

  _render() {
    const { scrollLeft: left, scrollTop: top, clientWidth: width, clientHeight: height } = this.box;
    const [first, last] = inSight(this.layout, { left, top, width, height }, { count: this.ids.length, strip: this.strip });
    const wanted = this.ids.slice(first, last);
    const keep = new Set(wanted);
    for (const [id, tile] of this.tiles) {
      if (keep.has(id)) continue;
      tile.querySelector("img")?.removeAttribute("src"); // if it still loads, it would hold up those in view
      tile.remove();
      this.tiles.delete(id);
    }
    wanted.forEach((id, n) => this._tile(id, first + n));
    this.rendered();
  }

  _tile(id, at) {
    let tile = this.tiles.get(id);
    if (!tile) {
      tile = this.make(id);
      this.tiles.set(id, tile);
      this.space.append(tile);
    }
    const [x, y] = this._corner(at);
    tile.style.transform = `translate(${x}px, ${y}px)`;
    tile.setAttribute("aria-posinset", String(at + 1));
    tile.setAttribute("aria-setsize", String(this.ids.length));
    this.update(tile, id);
  }
}
