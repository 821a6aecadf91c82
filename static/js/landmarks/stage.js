/** The 3D canvas: an orthographic view from above and a perspective view in space; drawn only on changes. */

import { Group, MOUSE, OrthographicCamera, PerspectiveCamera, Scene, TOUCH, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/orbit-controls";
import { preventTextDrag } from "../shared/dom.js";
import { HeldKeys } from "./keys.js";

const UP = new Vector3(0, 0, 1);
const SLOW_MS = 45;
const QUICK_MS = 22;
const FIRST_POINTS = 100_000;
const LEAST_POINTS = 20_000;
const CLICK_PX = 5;
const PICK_PX = { mouse: 14, touch: 26, pen: 18 };
const LONGEST_STEP_S = 0.1;

/** View of a scene, and its controls. */
export class Stage {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {{moved: function(): void, pick: function(?Object): void}} on
   */
  constructor(canvas, on) {
    this.canvas = canvas;
    this.on = on;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
    this.scene = new Scene();
    this.backdrop = new Group();
    this.scene.add(this.backdrop);
    this.points = null;
    this.frusta = null;
    this.pointSize = 2;
    this._budget = FIRST_POINTS;
    this._drawn = 0;
    this._last = 0;
    this._frame = 0;
    const above = new OrthographicCamera();
    const space = new PerspectiveCamera(55);
    for (const camera of [above, space]) camera.up.copy(UP);
    preventTextDrag(this.canvas);
    this.views = { above: this._view(above), space: this._view(space) };
    Object.assign(this.views.above, { enableRotate: false, screenSpacePanning: true });
    this.views.above.mouseButtons = { LEFT: MOUSE.PAN, MIDDLE: MOUSE.DOLLY, RIGHT: MOUSE.PAN };
    this.views.above.touches = { ONE: TOUCH.PAN, TWO: TOUCH.DOLLY_PAN };
    this.views.space.zoomToCursor = true;
    this.keys = new HeldKeys(canvas, () => this.invalidate());
    this._listenForClicks();
    this.show("space");
    new ResizeObserver(() => this._resize()).observe(canvas.parentElement);
  }

  /** @param {"above"|"space"} name */
  show(name) {
    this.name = name;
    for (const [other, controls] of Object.entries(this.views)) controls.enabled = other === name;
    this._resize();
  }

  get controls() {
    return this.views[this.name];
  }

  get camera() {
    return this.controls.object;
  }

  /** Scene units per screen pixel in the view from above. */
  get unitPerPixel() {
    const { top, bottom, zoom } = this.views.above.object;
    return (top - bottom) / zoom / this.canvas.clientHeight;
  }

  /**
   * Fit a box into both views.
   * @param {*} box a Box3
   */
  fit(box) {
    const middle = box.getCenter(new Vector3());
    const size = box.getSize(new Vector3());
    this.extent = Math.max(size.x, size.y, size.z, 1e-3);
    const space = this.views.space;
    space.target.copy(middle);
    const room = Math.min(1, this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight));
    const away = (0.44 * Math.hypot(size.x, size.y, size.z)) / Math.tan((27.5 * Math.PI) / 180) / room;
    space.object.position.copy(middle).addScaledVector(new Vector3(0.1, -0.75, 0.62).normalize(), away);
    space.object.near = away / 2000;
    space.object.far = away * 40;
    space.maxDistance = away * 10;
    const above = this.views.above;
    above.target.copy(middle);
    // A little to the south, so that north is at the top
    above.object.position.copy(middle).add(new Vector3(0, -1e-4 * this.extent, 20 * this.extent));
    above.object.near = 0;
    above.object.far = 60 * this.extent;
    above.object.zoom = 1;
    this._spans = [size.x * 1.15, size.y * 1.15];
    this._resize();
    for (const controls of Object.values(this.views)) controls.update();
    this.invalidate();
  }

  /**
   * Move until a point is visible, unless it is.
   * @param {number[]} point
   * @param {DOMRect} cover part of the screen that is covered, at the right or the bottom of the view
   */
  reveal(point, cover) {
    const at = new Vector3().fromArray(point);
    const seen = at.clone().project(this.camera);
    const view = this.canvas.getBoundingClientRect();
    const isBelow = cover.width > 0.6 * view.width;
    const right = isBelow ? 1 : (2 * (cover.left - view.left)) / view.width - 1;
    const bottom = isBelow ? 1 - (2 * (cover.top - view.top)) / view.height : -1;
    const isFree = seen.x > -0.9 && seen.x < right - 0.1 && seen.y > bottom + 0.1 && seen.y < 0.9;
    if (isFree && Math.abs(seen.z) < 1) return;
    const { object, target } = this.controls;
    object.position.add(at.clone().sub(target));
    target.copy(at);
    this._shift((1 - right) / 2, (-1 - bottom) / 2);
    this.invalidate();
  }

  /** Pan, in units of half the view's size at its target. @param {number} right @param {number} up */
  _shift(right, up) {
    const { object, target } = this.controls;
    object.updateMatrixWorld();
    const [half, aspect] = object.isOrthographicCamera
      ? [object.top / object.zoom, object.right / object.top]
      : [object.position.distanceTo(target) * Math.tan((object.fov * Math.PI) / 360), object.aspect];
    const move = new Vector3().setFromMatrixColumn(object.matrixWorld, 0).multiplyScalar(right * half * aspect);
    move.addScaledVector(new Vector3().setFromMatrixColumn(object.matrixWorld, 1), up * half);
    object.position.add(move);
    target.add(move);
  }

  /** Look from a photo's camera. @param {Object} camera @param {number} ahead distance of the target */
  lookFrom({ at, rotation }, ahead) {
    const { object, target } = this.views.space;
    object.position.fromArray(at);
    target.copy(object.position).addScaledVector(new Vector3().fromArray(rotation[2]), ahead);
    this.invalidate();
  }

  /** Schedule a redraw. */
  invalidate() {
    this._changed = true;
    this._schedule();
  }

  _schedule() {
    if (!this._frame) this._frame = requestAnimationFrame((now) => this._draw(now));
  }

  /** The nearest camera to a point of the canvas, or null. @param {PointerEvent} event */
  _pick({ offsetX, offsetY, pointerType }) {
    if (!this.frusta?.object.visible) return null;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const at = new Vector3();
    let best = null;
    let least = PICK_PX[pointerType] ?? PICK_PX.mouse;
    for (const camera of this.frusta.cameras) {
      at.fromArray(camera.at).project(this.camera);
      if (Math.abs(at.z) > 1) continue;
      const away = Math.hypot(((at.x + 1) / 2) * width - offsetX, ((1 - at.y) / 2) * height - offsetY);
      if (away < least) [best, least] = [camera, away];
    }
    return best;
  }

  _view(camera) {
    const controls = new OrbitControls(camera, this.canvas);
    controls.enableDamping = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    controls.dampingFactor = 0.15;
    controls.addEventListener("change", () => this.invalidate());
    return controls;
  }

  _listenForClicks() {
    let down = null;
    this.canvas.addEventListener("pointerdown", (event) => (down = event.isPrimary ? [event.offsetX, event.offsetY] : null));
    this.canvas.addEventListener("pointerup", (event) => {
      if (!down || event.button !== 0 || Math.hypot(event.offsetX - down[0], event.offsetY - down[1]) > CLICK_PX) return;
      this.on.pick(this._pick(event));
    });
  }

  _resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    const { space, above } = this.views;
    space.object.aspect = width / height;
    const [wide, high] = this._spans ?? [2, 2];
    const unit = Math.max(wide / width, high / height) / 2;
    Object.assign(above.object, { left: -unit * width, right: unit * width, top: unit * height, bottom: -unit * height });
    for (const { object } of [space, above]) object.updateProjectionMatrix();
    this.invalidate();
  }

  _draw(now) {
    this._frame = 0;
    const wanted = this.keys.wanted;
    const since = Math.min((now - this._last) / 1000, LONGEST_STEP_S);
    if (wanted) this._step(wanted, since);
    const moving = this.controls.update() || wanted !== null;
    if (this._running) this._adapt(now - this._last);
    this._last = now;
    this._render();
    this._running = moving || this._drawn < (this.points?.total ?? 0);
    if (moving) this.invalidate();
    else if (this._running) this._schedule();
  }

  /** Draw some of the points; while nothing changes, each frame adds more. */
  _render() {
    const anew = this._changed;
    this._changed = false;
    if (anew) this._drawn = 0;
    const next = Math.min(this.points?.total ?? 0, this._drawn + this._budget);
    this.points?.show(this._drawn, next);
    this._drawn = next;
    this.backdrop.visible = anew;
    this.renderer.autoClear = anew;
    const ratio = this.renderer.getPixelRatio();
    this.points?.set("reach", this.name === "space" ? this.camera.position.distanceTo(this.controls.target) : 0);
    this.points?.set("pointSize", this.pointSize * ratio);
    this.renderer.render(this.scene, this.camera);
    if (anew) this.on.moved();
  }

  /** Adapt the number of points per frame to the frame time. */
  _adapt(took) {
    if (took > SLOW_MS) this._budget = Math.max(LEAST_POINTS, 0.7 * this._budget);
    else if (took < QUICK_MS) this._budget = Math.min(1.25 * this._budget, Math.max(FIRST_POINTS, this.points?.total ?? 0));
  }

  /** Move as the keys ask for, during some seconds. */
  _step({ forward, right, up, turn, tilt, zoom }, seconds) {
    const { object, target } = this.controls;
    const away = object.position.distanceTo(target);
    if (this.name === "above") {
      const step = 0.6 * seconds * this.unitPerPixel * this.canvas.clientHeight;
      const move = new Vector3(step * (right + turn), step * (forward + tilt), 0);
      for (const one of [object.position, target]) one.add(move);
      object.zoom *= Math.exp(1.5 * zoom * seconds);
      object.updateProjectionMatrix();
      this.invalidate();
      return;
    }
    const offset = object.position.clone().sub(target).applyAxisAngle(UP, -1.2 * turn * seconds);
    const side = new Vector3().crossVectors(offset, UP).normalize();
    const lean = offset.angleTo(UP) - 0.9 * tilt * seconds;
    if (lean > 0.02 && lean < Math.PI - 0.02) offset.applyAxisAngle(side, 0.9 * tilt * seconds);
    offset.multiplyScalar(Math.exp(-1.5 * zoom * seconds));
    object.position.copy(target).add(offset);
    const ahead = offset.clone().negate().normalize();
    const move = ahead.multiplyScalar(forward).addScaledVector(side, -right).addScaledVector(UP, up);
    move.multiplyScalar(0.7 * seconds * Math.max(away, 0.02 * (this.extent ?? 1)));
    for (const one of [object.position, target]) one.add(move);
  }
}
