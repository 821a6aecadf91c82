/** Zoom into a photo: wheel, pinch, drag, double-click, buttons. */

import { preventTextDrag } from "./dom.js";

const MOST = 8;
const STEP = 1.6;

/** Zoom and pan of the image in a frame; starts with the whole photo. */
export class PhotoZoom {
  /**
   * @param {HTMLElement} frame
   * @param {HTMLImageElement} image
   */
  constructor(frame, image) {
    this.frame = frame;
    this.image = image;
    this.fingers = new Map();
    this.reset();
    frame.addEventListener("wheel", (event) => this._wheel(event), { passive: false });
    frame.addEventListener("dblclick", (event) => this._toggle(event));
    preventTextDrag(frame);
    frame.addEventListener("pointerdown", (event) => this._down(event));
    frame.addEventListener("pointermove", (event) => this._move(event));
    const lift = (event) => this.fingers.delete(event.pointerId);
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) frame.addEventListener(end, lift);
  }

  /** Show the whole photo. */
  reset() {
    this.scale = 1;
    this.at = [0, 0];
    this._show();
  }

  /** Zoom by a button. @param {1|-1} direction */
  step(direction) {
    this._zoom(STEP ** direction, [0, 0]);
  }

  /** Zoom around a fixed point, given from the middle of the frame. @param {number} factor @param {number[]} point */
  _zoom(factor, [x, y]) {
    const scale = Math.min(Math.max(this.scale * factor, 1), MOST);
    const ratio = scale / this.scale;
    this.at = [x - (x - this.at[0]) * ratio, y - (y - this.at[1]) * ratio];
    this.scale = scale;
    this._show();
  }

  _wheel(event) {
    if (event.deltaY > 0 && this.scale === 1) return; // let the panel scroll
    event.preventDefault();
    this._zoom(Math.exp(-event.deltaY / 300), this._fromMiddle(event));
  }

  _toggle(event) {
    if (event.target.closest("button")) return;
    if (this.scale > 1) this.reset();
    else this._zoom(2.5, this._fromMiddle(event));
  }

  _down(event) {
    if (event.target.closest("button")) return;
    this.fingers.set(event.pointerId, this._fromMiddle(event));
    if (this.scale > 1 || this.fingers.size > 1) this.frame.setPointerCapture(event.pointerId);
  }

  _move(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) return;
    const now = this._fromMiddle(event);
    const other = [...this.fingers].find(([id]) => id !== event.pointerId)?.[1];
    if (other) {
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      this._zoom(apart(now) / apart(before), other);
    } else if (this.scale > 1) {
      this.at = [this.at[0] + now[0] - before[0], this.at[1] + now[1] - before[1]];
      this._show();
    }
    this.fingers.set(event.pointerId, now);
  }

  _fromMiddle(event) {
    const box = this.frame.getBoundingClientRect();
    return [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
  }

  _show() {
    const reach = (this.scale - 1) / 2;
    const limit = (value, size) => Math.min(Math.max(value, -size * reach), size * reach);
    this.at = [limit(this.at[0], this.frame.clientWidth), limit(this.at[1], this.frame.clientHeight)];
    this.image.style.transform = `translate(${this.at[0]}px, ${this.at[1]}px) scale(${this.scale})`;
    this.frame.classList.toggle("is-zoomed", this.scale > 1);
  }
}
