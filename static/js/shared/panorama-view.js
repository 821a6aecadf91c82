/**
 * A panorama seen from inside, drawn by WebGL over its flat picture: dragging, the wheel, pinching and keys control
 * the view, and a compass shows its heading. Without WebGL the flat picture stays.
 */

import { h } from "./dom.js";
import { t } from "./i18n.js";
import { rafThrottle } from "./timing.js";

const FOV = { least: 20, usual: 80, most: 110 };
const STEEPEST = 85;
const STEP = 6;
const SHARPEST = 4096;
const ZOOM = 1.25;
const CORNERS = new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]);

const VERTEX = `
attribute vec2 corner;
uniform vec2 reach;
varying vec2 ray;
void main() {
  ray = corner * reach;
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

const FRAGMENT = `
precision highp float;
uniform sampler2D sphere;
uniform vec2 look;
varying vec2 ray;
const float PI = 3.14159265358979;
void main() {
  float c = cos(look.y), s = sin(look.y);
  vec3 at = normalize(vec3(ray.x, ray.y * c + s, c - ray.y * s));
  float around = (atan(at.x, at.z) + look.x) / (2.0 * PI) + 0.5;
  gl_FragColor = texture2D(sphere, vec2(fract(around), 0.5 - asin(clamp(at.y, -1.0, 1.0)) / PI));
}`;

const radians = (degrees) => (degrees * Math.PI) / 180;
/** An angle in [-180, 180) degrees. */
const turned = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;
const whole = (degrees) => ((Math.round(degrees) % 360) + 360) % 360;
const between = (value, least, most) => Math.min(Math.max(value, least), most);

/** @param {string} src @returns {Promise<?HTMLImageElement>} null if it cannot be decoded */
async function decoded(src) {
  const picture = new Image();
  picture.src = src;
  return picture.decode().then(() => picture, () => null);
}

/**
 * What the view shows of a photo: the original, unless parts are blurred or a share leaves it out; null for a flat photo.
 * @param {{name: string, panorama: ?Object, preview: ?string, blurred?: Object[], original?: ?string}} photo
 * @param {?number} heading
 */
export function insideOf({ name, panorama, preview, blurred, original }, heading) {
  if (!panorama || !preview) return null;
  const sharp = blurred ? (blurred.length ? null : preview.replace(/preview[^/]*$/, "original")) : original;
  return { name, src: preview, sharp, heading };
}

/** The view; fires `look` when it is turned or zoomed. */
export class PanoramaView extends EventTarget {
  /** @param {HTMLImageElement} image the flat picture, in a positioned frame */
  constructor(image) {
    super();
    this.image = image;
    this.canvas = h("canvas", { class: "panorama__canvas", tabindex: "0", role: "slider", "aria-valuemin": "0", "aria-valuemax": "359" });
    this.compass = h("div", { class: "panorama__compass", "aria-hidden": "true" });
    this.root = h("div", { class: "panorama", hidden: true }, this.canvas, this.compass);
    image.after(this.root);
    this._fingers = new Map();
    this._gl = null;
    this._source = null;
    this._heading = null;
    this._pitch = 0;
    this.turn = 0;
    this.fov = FOV.usual;
    this._draw = rafThrottle(() => this._paint());
    this._listen();
    this._sized = new ResizeObserver(this._draw);
    this._sized.observe(this.root);
  }

  get isShown() {
    return !this.root.hidden;
  }

  /**
   * Show a panorama; null shows the flat picture.
   * @param {?{name: string, src: string, sharp?: ?string, heading?: ?number}} panorama `sharp`: address of the original,
   *   if it may be shown; `heading`: heading of the middle
   * @param {number} [turn] initial direction, degrees clockwise from the middle
   */
  show(panorama, turn = 0) {
    this._heading = panorama?.heading ?? null;
    if (panorama?.src === this._source) return this._draw();
    this._source = panorama?.src ?? null;
    this.root.hidden = true;
    this.image.classList.remove("is-inside");
    if (!panorama || !this._begin()) return undefined;
    this.canvas.setAttribute("aria-label", t("Direction of view in {name}", { name: panorama.name }));
    [this.turn, this._pitch, this.fov] = [turned(turn), 0, FOV.usual];
    return this._load(panorama);
  }

  /** Zoom by a button. @param {1|-1} direction */
  step(direction) {
    this._look({ fov: this.fov * ZOOM ** -direction });
  }

  /** Free the WebGL context. */
  close() {
    this._sized.disconnect();
    this._gl?.getExtension("WEBGL_lose_context")?.loseContext();
  }

  /** @param {{src: string, sharp?: ?string}} panorama */
  async _load({ src, sharp }) {
    const isStill = () => this._source === src;
    const picture = await decoded(src);
    if (!picture || !isStill()) return; // damaged: the flat picture shows it
    this._take(picture);
    this.root.hidden = false;
    this.image.classList.add("is-inside");
    this._paint();
    if (!sharp) return;
    const full = await decoded(sharp);
    if (!full || !isStill()) return; // format unknown to the browser: the preview stays
    const most = Math.min(SHARPEST, this._gl.getParameter(this._gl.MAX_TEXTURE_SIZE));
    const fits = full.naturalWidth <= most;
    const texture = fits ? full : await createImageBitmap(full, { resizeWidth: most, resizeQuality: "high" });
    if (!isStill()) return;
    this._take(texture);
    this._draw();
  }

  /** Prepare the canvas; false if the browser has no WebGL. */
  _begin() {
    if (this._gl) return true;
    const gl = this.canvas.getContext("webgl", { alpha: false, antialias: false });
    if (!gl) return false;
    const program = gl.createProgram();
    for (const { kind, text } of [{ kind: gl.VERTEX_SHADER, text: VERTEX }, { kind: gl.FRAGMENT_SHADER, text: FRAGMENT }]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "corner");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) return false;
    gl.useProgram(program);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, CORNERS, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 2, gl.FLOAT, false, 0, 0);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) {
      gl.texParameteri(gl.TEXTURE_2D, name, value);
    }
    this._reach = gl.getUniformLocation(program, "reach");
    this._at = gl.getUniformLocation(program, "look");
    this._gl = gl;
    this.canvas.addEventListener("webglcontextlost", () => {
      this._gl = null;
      this.show(null);
    });
    return true;
  }

  _take(picture) {
    const gl = this._gl;
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, picture);
  }

  _paint() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!this._gl || !this.isShown || !width || !height) return;
    const ratio = Math.min(devicePixelRatio || 1, 2);
    [this.canvas.width, this.canvas.height] = [width * ratio, height * ratio].map(Math.round);
    const gl = this._gl;
    const { across, down } = this._half(width, height);
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.uniform2f(this._reach, across, down);
    gl.uniform2f(this._at, radians(this.turn), radians(this._pitch));
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    this._say(across);
  }

  /** Half the size of the view at distance 1; the field of view is that of the longer side. */
  _half(width = this.canvas.clientWidth, height = this.canvas.clientHeight) {
    const longer = Math.tan(radians(this.fov) / 2);
    const unit = longer / Math.max(width, height);
    return { across: width * unit, down: height * unit };
  }

  /** Update the compass, and its text for screen readers. */
  _say(across) {
    const looks = this.turn + (this._heading ?? 0);
    const known = this._heading !== null;
    const letters = known ? [t("N"), t("NE"), t("E"), t("SE"), t("S"), t("SW"), t("W"), t("NW")] : [];
    const marks = letters.map((letter, n) => ({ letter, off: turned(45 * n - looks) }))
      .filter(({ off }) => Math.abs(off) < 80)
      .map(({ letter, off }) => ({ letter, at: 50 * (1 + Math.tan(radians(off)) / across) }))
      .filter(({ at }) => at > 3 && at < 97)
      .map(({ letter, at }) => {
        const mark = h("span", { class: "panorama__mark" }, letter);
        mark.style.left = `${at}%`;
        return mark;
      });
    const words = known ? `${whole(looks)}°` : t("{degrees}° from the middle", { degrees: Math.round(this.turn) });
    this.compass.replaceChildren(...marks, h("span", { class: "panorama__heading" }, words));
    this.canvas.setAttribute("aria-valuenow", String(whole(looks)));
    this.canvas.setAttribute("aria-valuetext", words);
  }

  _look({ turn = this.turn, pitch = this._pitch, fov = this.fov }) {
    this.turn = turned(turn);
    this._pitch = between(pitch, -STEEPEST, STEEPEST);
    this.fov = between(fov, FOV.least, FOV.most);
    this._draw();
    this.dispatchEvent(new Event("look"));
  }

  _listen() {
    const { canvas } = this;
    const on = (name, run) => canvas.addEventListener(name, (event) => {
      event.stopPropagation(); // the frame would zoom the flat picture
      run(event);
    });
    on("pointerdown", (event) => {
      if (event.button !== 0) return;
      canvas.setPointerCapture(event.pointerId);
      this._fingers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    on("pointermove", (event) => this._drag(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) on(end, (event) => this._fingers.delete(event.pointerId));
    on("dblclick", () => this._look({ turn: 0, pitch: 0, fov: FOV.usual }));
    canvas.addEventListener("wheel", (event) => {
      event.stopPropagation();
      event.preventDefault();
      this._look({ fov: this.fov * Math.exp(event.deltaY / 600) });
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this._key(event));
  }

  _drag(event) {
    const before = this._fingers.get(event.pointerId);
    if (!before) return;
    const now = [event.clientX, event.clientY];
    const other = [...this._fingers].find(([id]) => id !== event.pointerId)?.[1];
    this._fingers.set(event.pointerId, now);
    if (other) {
      const apart = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]) || 1;
      this._look({ fov: (this.fov * apart(before)) / apart(now) });
      return;
    }
    const perPixel = (2 * this._half().across * 180) / Math.PI / this.canvas.clientWidth;
    this._look({ turn: this.turn - (now[0] - before[0]) * perPixel, pitch: this._pitch + (now[1] - before[1]) * perPixel });
  }

  _key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const keys = {
      ArrowLeft: { turn: this.turn - STEP }, ArrowRight: { turn: this.turn + STEP },
      ArrowUp: { pitch: this._pitch + STEP }, ArrowDown: { pitch: this._pitch - STEP },
      "+": { fov: this.fov / ZOOM }, "-": { fov: this.fov * ZOOM }, Home: { turn: 0, pitch: 0, fov: FOV.usual },
    };
    if (!(event.key in keys)) return;
    event.preventDefault();
    event.stopPropagation();
    this._look(keys[event.key]);
  }
}
