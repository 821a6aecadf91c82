/** Speed, height or distance over the timeline; hovering marks the map, a click goes there. */

import { byId, h, queryAll } from "../shared/dom.js";
import { labelled, t } from "../shared/i18n.js";
import { ThemeColours } from "../shared/theme-colours.js";
import { debounce, rafThrottle } from "../shared/timing.js";
import { toastError } from "../shared/toast.js";
import { trackColour } from "./colour-scales.js";
import { lengthText, SHORTEST_S, spanText, speedText } from "./format.js";

const POINTS = 1000;
const CALM_MS = 2500;
const PAD = { top: 18, bottom: 6, side: 8 };
const QUANTITIES = {
  speed: { column: "speed_mps", text: speedText, name: () => t("Speed") },
  height: { column: "height_m", text: lengthText, name: () => t("Height") },
  distance: { column: "travelled_m", text: lengthText, name: () => t("Distance") },
};

/** The chart above the slider. */
export class Profile {
  /**
   * @param {import("./mission-store.js").MissionStore} store
   * @param {import("./scene.js").Scene} scene
   * @param {import("./player.js").Player} player
   */
  constructor(store, scene, player) {
    this.store = store;
    this.scene = scene;
    this.player = player;
    this.quantity = "speed";
    this.received = new Map();
    this.hover = null;
    this.canvas = byId("profile", HTMLCanvasElement);
    this._draw = rafThrottle(() => this._paint());
    this._inks = new ThemeColours(this.canvas.parentElement, ["--line", "--text", "--text-soft"], this._draw);
    this._later = debounce(() => this._load({ reload: true }), CALM_MS);
    this._choice();
    this._listen();
    store.on("missions shown", () => this._load());
    store.on("poses", this._later);
    store.on("moment grown mode", this._draw);
    new ResizeObserver(this._draw).observe(this.canvas);
    this._load();
  }

  _choice() {
    for (const button of queryAll("[data-quantity]", HTMLButtonElement)) {
      button.addEventListener("click", () => {
        this.quantity = button.dataset.quantity;
        for (const other of queryAll("[data-quantity]", HTMLButtonElement)) other.setAttribute("aria-pressed", String(other === button));
        this._facts();
        this._draw();
      });
    }
  }

  _listen() {
    const momentAt = ({ offsetX }) => {
      const { clock } = this.store;
      const share = (offsetX - PAD.side) / (this.canvas.clientWidth - 2 * PAD.side);
      return this._timed ? Math.min(Math.max(share, 0), 1) * clock.span : null;
    };
    const point = (moment) => {
      this.hover = moment;
      this.scene.setHover(moment);
      this._draw();
    };
    this.canvas.addEventListener("pointermove", (event) => point(momentAt(event)));
    this.canvas.addEventListener("pointerleave", () => point(null));
    this.canvas.addEventListener("click", (event) => {
      this.player.stop();
      const moment = momentAt(event);
      if (moment !== null) this.store.setMoment(moment);
    });
  }

  async _load({ reload = false } = {}) {
    const wanted = this.store.shown.filter(({ key, track }) => track.poses && (reload || !this.received.has(key)));
    await Promise.all(wanted.map(({ mission, track, key }) =>
      this.store.server(mission.id).profile(track.id, POINTS).then((received) => this.received.set(key, received), toastError)));
    this._facts();
    this._draw();
  }

  /** Maxima and totals of the first shown track as text, for screen readers, too. */
  _facts() {
    const shown = this.store.shown.find(({ key }) => this.received.has(key));
    const received = shown && this.received.get(shown.key);
    const rows = received ? factsOf(received, shown.track) : [];
    byId("profile-facts").replaceChildren(...rows.map(([name, value]) => h("span", {}, h("span", { class: "soft" }, name), " ", value)));
    const heights = [...this.received.values()].some(({ height_m: column }) => column.some(Number.isFinite));
    const [height, speed] = ["height", "speed"].map((name) => queryAll(`[data-quantity=${name}]`, HTMLButtonElement)[0]);
    height.disabled = !heights;
    speed.disabled = !this._timed;
    if (!this._timed && heights && this.quantity === "speed") height.click();
  }

  /** Whether the chart is over time; without meaningful times, it is over the distance. */
  get _timed() {
    return this.store.clock?.span >= SHORTEST_S;
  }

  _paint() {
    const { canvas, store } = this;
    const ratio = devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width) return; // hidden
    Object.assign(canvas, { width: width * ratio, height: height * ratio });
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    const { clock } = store;
    const { column, text, name } = QUANTITIES[this.quantity];
    const drawn = store.shown.filter(({ key, track }) => this.received.has(key) && (track.timed || !this._timed));
    const series = drawn.map((one) => ({ ...one, received: this.received.get(one.key) }));
    const values = series.flatMap(({ received }) => received[column].filter(Number.isFinite));
    const [low, high] = values.length ? rangeOf(values, this.quantity) : [0, 1];
    const across = (share) => PAD.side + share * (width - 2 * PAD.side);
    const x = (moment) => across(moment / clock.span);
    const way = Math.max(1, ...series.map(({ received }) => received.travelled_m.at(-1) || 0));
    const place = ({ received, mission }) => (n) => (this._timed ? x(store.momentOf(mission, received.time_s[n])) : across(received.travelled_m[n] / way));
    const y = (value) => height - PAD.bottom - ((value - low) / (high - low)) * (height - PAD.top - PAD.bottom);
    const ink = this._inks.all;
    frame(pen, { width, bottom: y(low), top: y(high), colour: ink.line });
    for (const one of series.toReversed()) {
      curve(pen, one.received[column], { x: place(one), y, colour: trackColour(store, one), fill: series.length === 1 && y(low) });
    }
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "top";
    pen.fillStyle = ink.textSoft;
    if (values.length) pen.fillText(labelled(name(), `${text(low)} – ${text(high)}`), PAD.side, 2);
    if (!this._timed) return;
    if (store.moment !== null) cursor(pen, x(store.moment), { height, colour: ink.text, width: 2 });
    if (this.hover !== null) this._pointed(pen, { x: x(this.hover), width, height, colour: ink.textSoft }, series);
  }

  /** Draw the values at the pointer. */
  _pointed(pen, { x, width, height, colour }, series) {
    cursor(pen, x, { height, colour, width: 1 });
    const { column, text } = QUANTITIES[this.quantity];
    const values = series.map(({ received, mission }) => valueAt(received, column, this.store.timeIn(mission, this.hover))).filter(Number.isFinite);
    const words = [spanText(this.hover), ...values.slice(0, 3).map(text)].join("  ·  ");
    pen.textAlign = "end";
    pen.fillText(words, width - PAD.side, 2);
    pen.textAlign = "start";
  }
}

function factsOf({ speed_mps: speeds, height_m: heights, travelled_m: way }, track) {
  const rows = [[t("Distance"), lengthText(track.distance_m ?? way.at(-1) ?? 0)]];
  const timed = track.duration_s >= SHORTEST_S;
  if (timed) {
    rows.push([t("Duration"), spanText(track.duration_s)], [t("Mean"), speedText(track.distance_m / track.duration_s)]);
  }
  const most = speeds.filter(Number.isFinite).reduce((a, b) => Math.max(a, b), 0);
  if (timed && most) rows.push([t("Fastest"), speedText(most)]);
  const known = heights.filter(Number.isFinite);
  if (known.length > 1) {
    const climb = known.reduce((sum, value, n) => sum + Math.max(0, n ? value - known[n - 1] : 0), 0);
    rows.push([t("Climb"), lengthText(climb)]);
  }
  return rows;
}

function rangeOf(values, quantity) {
  const [low, high] = values.reduce(([a, b], value) => [Math.min(a, value), Math.max(b, value)], [Infinity, -Infinity]);
  const from = quantity === "height" ? low : 0;
  return [from, high > from ? high : from + 1];
}

function frame(pen, { width, bottom, top, colour }) {
  pen.strokeStyle = colour;
  pen.lineWidth = 1;
  for (const at of [bottom, (bottom + top) / 2, top]) {
    pen.beginPath();
    pen.moveTo(PAD.side, Math.round(at) + 0.5);
    pen.lineTo(width - PAD.side, Math.round(at) + 0.5);
    pen.stroke();
  }
}

function curve(pen, values, { x, y, colour, fill }) {
  const line = new Path2D();
  let [joined, first, last] = [false, null, null];
  values.forEach((value, n) => {
    if (!Number.isFinite(value)) return (joined = false);
    /** @type {[number, number]} */
    const at = [x(n), y(value)];
    if (joined) line.lineTo(...at);
    else line.moveTo(...at);
    first ??= at;
    last = at;
    joined = true;
    return null;
  });
  if (!last) return;
  if (fill) {
    const area = new Path2D(line);
    area.lineTo(last[0], fill);
    area.lineTo(first[0], fill);
    pen.globalAlpha = 0.15;
    pen.fillStyle = colour;
    pen.fill(area);
    pen.globalAlpha = 1;
  }
  pen.lineWidth = 1.75;
  pen.strokeStyle = colour;
  pen.stroke(line);
}

function cursor(pen, x, { height, colour, width }) {
  pen.fillStyle = colour;
  pen.fillRect(x - width / 2, PAD.top - 2, width, height - PAD.top + 2);
}

function valueAt({ time_s: times, ...received }, column, time) {
  const n = times.findIndex((one) => one >= time);
  return n < 0 ? NaN : received[column][n];
}
