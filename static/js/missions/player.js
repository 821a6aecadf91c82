/** The timeline: the slider, and the replay that moves it. */

import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { clockText, DAY_S, SHORTEST_S, spanText, timeText } from "./format.js";

const STEPS = 400;
const SHOWN_EVERY_MS = 100;

/** Slider, play button and speed. */
export class Player {
  /** @param {import("./mission-store.js").MissionStore} store */
  constructor(store) {
    this.store = store;
    this.slider = byId("moment", HTMLInputElement);
    this.button = byId("play", HTMLButtonElement);
    this.speed = byId("replay-speed", HTMLSelectElement);
    this.now = byId("now");
    this._playing = 0;
    this._before = 0;
    this._shownAt = 0;
    this.slider.addEventListener("input", () => this._seek(this.slider.valueAsNumber));
    this.button.addEventListener("click", () => this.toggle());
    this.now.addEventListener("click", () => this.end());
    store.on("missions shown grown moment", () => this._render());
    byId("time").inert = false; // inert until its listeners are attached
    this._render();
  }

  get playing() {
    return this._playing !== 0;
  }

  /** Start or stop the replay; at the end it restarts. */
  toggle() {
    if (this.playing) return this.stop();
    const { clock, moment } = this.store;
    if (!clock) return;
    if (moment === null || moment >= clock.span) this.store.setMoment(0);
    this._before = performance.now();
    this._playing = requestAnimationFrame((now) => this._turn(now));
    this._render();
  }

  stop() {
    cancelAnimationFrame(this._playing);
    this._playing = 0;
    this._render();
  }

  /** Show everything, including new data. */
  end() {
    this.stop();
    this.store.setMoment(null);
  }

  _seek(moment) {
    this.store.setMoment(moment >= Number(this.slider.max) ? null : moment);
  }

  _turn(now) {
    const { clock, moment } = this.store;
    const next = moment + ((now - this._before) / 1000) * Number(this.speed.value);
    this._before = now;
    if (!clock || moment === null || next >= clock.span) return this.end();
    this._playing = requestAnimationFrame((later) => this._turn(later));
    this.store.setMoment(next);
  }

  _render() {
    const { clock, moment } = this.store;
    const { slider, button } = this;
    slider.disabled = button.disabled = !(clock?.span >= SHORTEST_S);
    button.setAttribute("aria-label", this.playing ? t("Pause") : t("Replay"));
    button.classList.toggle("is-on", this.playing);
    button.querySelector(".mi-play").toggleAttribute("hidden", this.playing);
    button.querySelector(".mi-pause").toggleAttribute("hidden", !this.playing);
    this.now.setAttribute("aria-pressed", String(moment === null && !this.store.mission?.ended_at));
    if (!clock) return;
    byId("time").classList.toggle("is-instant", clock.span < SHORTEST_S); // a single moment has no timeline
    slider.max = String(clock.span);
    slider.step = "any";
    slider.value = String(moment ?? clock.span);
    this._tell(clock, moment ?? clock.span);
  }

  /** Update the texts, at most ten times a second. */
  _tell({ first, span, aligned }, moment) {
    const now = performance.now();
    if (this.playing && now - this._shownAt < SHOWN_EVERY_MS) return;
    this._shownAt = now;
    const text = aligned ? spanText(moment) : (span < DAY_S ? timeText : clockText)(first + moment);
    byId("moment-text").textContent = aligned ? "" : text;
    byId("moment-span").textContent = `${spanText(moment)} / ${spanText(span)}`;
    this.slider.setAttribute("aria-valuetext", text);
  }

  /** Move by a fraction of the timeline, for keys. @param {number} direction */
  step(direction) {
    const { clock, moment } = this.store;
    if (!clock) return;
    const next = (moment ?? clock.span) + (direction * clock.span) / STEPS;
    this._seek(Math.max(0, next));
  }
}
