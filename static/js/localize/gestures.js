/** Clicks and keys on the map: select a hypothesis, draw the circle of a hint, correct the position. */

import { byId, icon, takesText } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { clamped, isInside } from "../shared/map/coords.js";
import { Crosshair } from "../shared/map/crosshair.js";

const STILL = { mouse: 4, touch: 10 };
const STEP = 8;
const FAST_STEP = 48;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const USUAL_RADIUS = 0.12;

/** Turns gestures on one map into changes of the session. */
export class AnswerGestures {
  /**
   * @param {import("../shared/map/map-view.js").MapView} view
   * @param {Object} marks an `AnswerLayer`
   * @param {import("../shared/answer/query-session.js").QuerySession} session
   * @param {function(string): void} say
   */
  constructor(view, marks, session, say) {
    this.view = view;
    this.marks = marks;
    this.session = session;
    this.say = say;
    this.press = null;
    this.crosshair = new Crosshair(view, say);
    const { element } = view;
    element.addEventListener("pointerdown", (event) => this._down(event), { capture: true });
    addEventListener("pointermove", (event) => this._move(event));
    addEventListener("pointerup", (event) => this._up(event));
    addEventListener("pointercancel", () => this._end());
    element.addEventListener("keydown", (event) => this._key(event));
    session.on("mode", () => this._mode());
  }

  _down(event) {
    if (!this.view.store.satellite || event.button !== 0 || event.target.closest("button, a")) return;
    if (this.press) {
      const second = event.pointerId !== this.press.id;
      this._end();
      if (second) return; // a second finger: a pinch; otherwise the pointerup of the first press was lost
    }
    const pointer = event.pointerType === "touch" ? "touch" : "mouse";
    const point = this.view.map.mouseEventToContainerPoint(event);
    this.press = { id: event.pointerId, pointer, point, start: this.view.pixelAt(event), moved: false };
    if (this._draws) this.view.map.dragging.disable();
  }

  get _draws() {
    return this.session.mode === "hint" && this.view.store.placement === null;
  }

  _move(event) {
    const { press } = this;
    if (!press || event.pointerId !== press.id) return;
    const point = this.view.map.mouseEventToContainerPoint(event);
    if (!press.moved && point.distanceTo(press.point) < STILL[press.pointer]) return;
    press.moved = true;
    if (this._draws) this.marks.setDraft(this._circle(press.start, this.view.pixelAt(event)));
  }

  _up(event) {
    const { press, session } = this;
    if (!press || event.pointerId !== press.id) return;
    if (this._draws) {
      session.setHint(press.moved ? this.marks.draft : this._circle(press.start));
      session.setMode("look");
    } else if (!press.moved) {
      this._point(press.start, press.point, press.pointer);
    }
    this._end();
  }

  _end() {
    this.press = null;
    this.marks.setDraft(null);
    this.view.map.dragging.enable();
  }

  /** A circle around a pixel, through another one or of default size. */
  _circle(centre, edge = null) {
    const { satellite } = this.view.store;
    const [x, y] = clamped(centre, satellite);
    const usual = USUAL_RADIUS * Math.max(satellite.width, satellite.height);
    const radius = edge ? Math.max(Math.hypot(edge[0] - x, edge[1] - y), 1) : usual;
    return { x_px: x, y_px: y, radius_px: Math.round(radius) };
  }

  /** A click, or Enter on the crosshair. @param {number[]} pixel */
  _point(pixel, point, pointer = "mouse") {
    const { session, view } = this;
    if (session.mode === "correct" && view.store.placement === null) {
      if (isInside(pixel, view.store.satellite)) session.setSpot(clamped(pixel, view.store.satellite));
      else this.say(t("That is outside the image"));
      return;
    }
    const ranks = this.marks.near(point, pointer);
    if (ranks.length) session.choose(ranks[(ranks.indexOf(session.chosen) + 1) % ranks.length]);
  }

  _key(event) {
    const { crosshair, session, view } = this;
    const arrow = ARROWS[event.key];
    const step = event.shiftKey ? FAST_STEP : STEP;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (arrow) crosshair.move(arrow[0] * step, arrow[1] * step);
    else if (event.key === "+" || event.key === "=") view.zoom(0.5);
    else if (event.key === "-") view.zoom(-0.5);
    else if (event.key === "0") view.fit();
    else if (event.key === "Enter" && crosshair.visible && this._draws) {
      session.setHint(this._circle(crosshair.pixel));
      session.setMode("look");
    } else if (event.key === "Enter" && crosshair.visible) this._point(crosshair.pixel, crosshair.point);
    else return;
    event.preventDefault();
  }

  _mode() {
    const placing = this.session.mode !== "look" && this.view.store.placement === null;
    this.view.element.classList.toggle("is-placing", placing);
  }
}

/** Show what a click means; Escape ends it, digits select a place. @param {import("../shared/answer/query-session.js").QuerySession} session */
export function instructions(session) {
  const box = byId("instruction");
  const words = {
    hint: () => t("Draw a circle around the likely area: press in the middle and drag"),
    correct: () => t("Click where the photo was taken"),
  };
  session.on("mode", () => {
    box.hidden = session.mode === "look";
    box.classList.toggle("is-placing", !box.hidden);
    if (!box.hidden) box.replaceChildren(icon("target"), words[session.mode]());
  });
  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || document.querySelector("dialog[open]")) return;
    if (event.key === "Escape" && session.mode !== "look") {
      session.setMode("look");
      session.setSpot(null);
    } else if (/^[1-9]$/.test(event.key) && !takesText(event.target) && !event.ctrlKey && !event.metaKey && !event.altKey) {
      const rank = Number(event.key);
      if (session.answer?.hypotheses.some((found) => found.rank === rank)) session.choose(rank);
    }
  });
}
