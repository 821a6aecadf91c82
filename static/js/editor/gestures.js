/** Mouse, pen and touch on the image: place, select, drag, turn, box; Leaflet handles pan, wheel and pinch. */

import { h } from "../shared/dom.js";
import { clamped, imageAngle, isInside } from "../shared/map/coords.js";
import { rafThrottle } from "../shared/timing.js";

const LONG_PRESS_MS = 500;
const STILL = { mouse: 4, touch: 10 };
const COARSE_STEP = 15;
/** A second click within this time and distance is part of a double click: it places no second photo. */
const DOUBLE_MS = 500;
const DOUBLE_PX = 10;
/** Up to this many overlapping dots are spread in a circle; for more, the view zooms in. */
const MOST_SPREAD = 40;
const NEARER = 2;

/** Turns pointer events into commands. */
export class EditGestures {
  /**
   * @param {import("../shared/map/map-view.js").MapView} view
   * @param {Object} dots layer of the photos (`PhotoDots`)
   * @param {import("./commands.js").Commands} commands
   */
  constructor(view, dots, commands) {
    this.view = view;
    this.dots = dots;
    this.commands = commands;
    this.store = commands.store;
    /** @type {Array<{active: boolean, add: function(number[]): void}>} tools that receive the clicks while active */
    this.interceptors = [];
    /** @type {?Object<string, *>} the present gesture */
    this.gesture = null;
    const { element } = view;
    element.addEventListener("pointerdown", (event) => this._down(event), { capture: true });
    addEventListener("pointermove", (event) => this._move(event));
    addEventListener("pointerup", (event) => this._up(event));
    addEventListener("pointercancel", () => this.cancel());
    const hover = rafThrottle(() => this._hover());
    element.addEventListener("pointermove", (event) => {
      this._last = event;
      hover();
    });
    this.store.on("tool", () => this._cursor());
    this._cursor();
  }

  /** Abort the gesture without any change. */
  cancel() {
    const { gesture } = this;
    if (!gesture) return;
    clearTimeout(gesture.timer);
    gesture.box?.remove();
    this.gesture = null;
    this.view.map.dragging.enable();
    this.store.setPreview(new Map());
  }

  _down(event) {
    const { dots } = this;
    if (!this.store.satellite || event.target.closest("button, a, input, .leaflet-marker-icon, .ed-overlay")) return;
    if (this.gesture) {
      const second = event.pointerId !== this.gesture.id;
      this.cancel();
      if (second) return; // a second finger: a pinch; otherwise the pointerup of the first press was lost
    }
    if (event.button !== 0) return;
    const pointer = event.pointerType === "touch" ? "touch" : "mouse";
    const point = this.view.map.mouseEventToContainerPoint(event);
    /** @type {Object<string, *>} */
    const gesture = { id: event.pointerId, pointer, point, start: this.view.pixelAt(event), moved: false };
    Object.assign(gesture, this._meaning(event, point, pointer));
    if (dots.isFanned && gesture.hit !== undefined) gesture.start = this.store.position(gesture.hit); // not where it is drawn
    if (gesture.mode !== "pan") this.view.map.dragging.disable();
    if (pointer === "touch") gesture.timer = setTimeout(() => this._longPress(), LONG_PRESS_MS);
    this.gesture = gesture;
  }

  /** The active tool. */
  get _taker() {
    return this.interceptors.find(({ active }) => active) ?? null;
  }

  /** The gesture that a press starts if it moves. */
  _meaning(event, point, pointer) {
    const { store, dots } = this;
    if (this._taker) return { mode: "pan" };
    if (store.canEdit && dots.onHandle(point, pointer)) return { mode: "turn", target: store.currentId };
    const [hit] = dots.near(point, pointer);
    if (hit === undefined) return { mode: event.shiftKey ? "box" : "pan" };
    const chosen = store.selection.has(hit) || hit === store.currentId;
    if (!store.canEdit || (pointer === "touch" && !chosen)) return { mode: "pan" };
    const ids = store.selection.has(hit) ? [...store.selection].filter((id) => store.isPlaced(id) && store.isOnFloor(id)) : [hit];
    return { mode: "drag", hit, from: new Map(ids.map((id) => [id, store.position(id)])) };
  }

  _move(event) {
    const { gesture } = this;
    if (!gesture || event.pointerId !== gesture.id) return;
    const point = this.view.map.mouseEventToContainerPoint(event);
    if (!gesture.moved && point.distanceTo(gesture.point) < STILL[gesture.pointer]) return;
    gesture.moved = true;
    clearTimeout(gesture.timer);
    if (gesture.mode === "drag") this._drag(gesture, this.view.pixelAt(event));
    if (gesture.mode === "turn") this._turn(gesture, this.view.pixelAt(event), event.shiftKey);
    if (gesture.mode === "box") this._box(gesture, point);
  }

  _up(event) {
    const { gesture } = this;
    if (!gesture || event.pointerId !== gesture.id) return;
    const { moved, mode, long } = gesture;
    if (!moved && !long) this._click(event, gesture);
    if (moved && mode === "drag") this.commands.move(gesture.to);
    if (moved && mode === "turn") this.commands.turn(gesture.target, gesture.heading);
    if (moved && mode === "box") this._choose(gesture);
    this.cancel();
  }

  _drag(gesture, [x, y]) {
    if (this.dots.isFanned) this.dots.fan([]);
    const [dx, dy] = [x - gesture.start[0], y - gesture.start[1]];
    const to = ([fromX, fromY]) => clamped([fromX + dx, fromY + dy], this.store.satellite);
    gesture.to = new Map([...gesture.from].map(([id, position]) => [id, to(position)]));
    this.view.showPosition([...gesture.to.values()][0]);
    this.store.setPreview(new Map([...gesture.to].map(([id, [x_px, y_px]]) => [id, { x_px, y_px }])));
  }

  _turn(gesture, pixel, coarse) {
    const position = this.store.position(gesture.target);
    const step = coarse ? COARSE_STEP : 1;
    const heading = imageAngle(position, pixel) - this.store.georeference.north(position);
    gesture.heading = (((Math.round(heading / step) * step) % 360) + 360) % 360;
    this.store.setPreview(new Map([[gesture.target, { heading_deg: gesture.heading }]]));
  }

  _box(gesture, point) {
    gesture.box ??= this.view.element.appendChild(h("div", { class: "ed-box" }));
    gesture.bounds = L.bounds([gesture.point, point]);
    const { min } = gesture.bounds;
    const size = gesture.bounds.getSize();
    Object.assign(gesture.box.style, {
      left: `${min.x}px`, top: `${min.y}px`, width: `${size.x}px`, height: `${size.y}px`,
    });
  }

  /** @param {Object<string, *>} gesture */
  _choose({ bounds }) {
    const { store } = this;
    store.setSelection([...store.selection, ...this.dots.within(bounds)]);
  }

  _longPress() {
    const { gesture } = this;
    const [hit] = this.dots.near(gesture.point, "touch");
    if (hit === undefined) return;
    gesture.long = true;
    navigator.vibrate?.(15);
    this.store.toggleSelected(hit);
  }

  /** @param {PointerEvent} event @param {Object<string, *>} gesture */
  _click(event, { point, pointer, mode }) {
    if (mode === "turn") return;
    const { store, dots } = this;
    if (this._taker) {
      this._taker.add(clamped(this.view.pixelAt(event), store.satellite));
      return;
    }
    const hits = dots.near(point, pointer);
    const choosing = event.shiftKey || event.ctrlKey || event.metaKey || (pointer === "touch" && store.selection.size);
    if (choosing) {
      if (hits.length) store.toggleSelected(hits[0]);
    } else if (store.tool === "place" && store.current && !store.isPlaced(store.currentId)) {
      this._place(event);
    } else if (hits.length > 1) {
      this._open(hits, point);
    } else {
      if (!hits.length) dots.fan([]);
      if (hits.length) store.setCurrent(hits[0]);
      else if (store.selection.size) store.setSelection([]);
    }
  }

  /** Spread overlapping dots, or zoom in if there are too many. */
  _open(hits, point) {
    const { dots, store, view } = this;
    const { map } = view;
    if (hits.length > MOST_SPREAD && map.getZoom() < map.getMaxZoom()) {
      map.setZoomAround(point, map.getZoom() + NEARER);
      return;
    }
    if (!dots.isFanned) dots.fan(hits.slice(0, MOST_SPREAD));
    store.setCurrent(hits[(hits.indexOf(store.currentId) + 1) % hits.length]);
  }

  _place(event) {
    const pixel = this.view.pixelAt(event);
    if (!isInside(pixel, this.store.satellite)) {
      this.commands.warnOutside();
      return;
    }
    const { clientX: x, clientY: y, timeStamp } = event;
    const last = this._placed;
    if (last && timeStamp - last.timeStamp < DOUBLE_MS && Math.hypot(x - last.x, y - last.y) < DOUBLE_PX) return;
    this._placed = { x, y, timeStamp };
    this.commands.placeCurrent(pixel);
  }

  _hover() {
    if (this.gesture || !this._last || this._last.pointerType === "touch") return;
    const point = this.view.map.mouseEventToContainerPoint(this._last);
    const handle = this.store.canEdit && this.dots.onHandle(point);
    const dot = !handle && this.store.tool === "select" && this.dots.near(point).length > 0;
    this.view.element.classList.toggle("is-on-handle", handle);
    this.view.element.classList.toggle("is-on-dot", dot);
  }

  _cursor() {
    this.view.element.classList.toggle("is-placing", this.store.tool === "place");
  }
}
