/** What is being done while a photo is looked for: in words, with the time so far, and as a bar by stages. */

import { h } from "../dom.js";
import { duration, t, tn } from "../i18n.js";

const TICK_MS = 1000;
const SHOWN_FROM_S = 3;
/** Where the bar is when a stage begins; the last one ends at 1. */
const BAR = { send: 0, read: 0.2, compare: 0.3, again: 0.65 };

export class WaitingWords {
  /** @param {HTMLElement} box of the words @param {HTMLProgressElement} bar */
  constructor(box, bar) {
    this.box = box;
    this.bar = bar;
    this.what = h("span", { role: "status" });
    this.seconds = h("span", { class: "number nowrap", "aria-hidden": "true" });
    box.replaceChildren(this.what, this.seconds);
    this._timer = 0;
  }

  /** @param {boolean} sends whether a photo is sent first */
  begin(sends) {
    this.end();
    if (sends) this._show(t("Sending the photo"), BAR.send);
    else this._read();
    this.box.hidden = this.bar.hidden = false;
    const begunAt = performance.now();
    this._timer = setInterval(() => this._tick((performance.now() - begunAt) / 1000), TICK_MS);
  }

  end() {
    clearInterval(this._timer);
    this.seconds.textContent = "";
    this.box.hidden = this.bar.hidden = true;
  }

  /** The map is being indexed; the photo waits. */
  waitForIndex() {
    this._show(t("Waiting until the map is indexed"), null);
  }

  /** Show the bytes that were sent. */
  sent(sent, all) {
    if (sent < all) this._show(t("Sending the photo"), BAR.send + (BAR.read - BAR.send) * (sent / all));
    else this._read();
  }

  /** Show what an event of the server says. @param {string} kind @param {Object} data */
  take(kind, data) {
    if (kind === "first") this._show(t("This is the first answer; a second look may change it"), BAR.again);
    else if (kind === "progress" && "map" in data) this._searching(data);
    else if (kind === "progress") this._comparing(data);
  }

  _read() {
    this._show(t("Reading the photo"), BAR.read);
  }

  _comparing({ photos, done, total }) {
    const words = tn("Comparing with {n} photo of the map", "Comparing with {n} photos of the map", photos);
    const which = total > 1 ? t("{done} of {total}", { done: done + 1, total }) : "";
    this._show([words, which].filter(Boolean).join(" · "), BAR.compare + (BAR.again - BAR.compare) * (done / total));
  }

  _searching({ map, done, total }) {
    const words = t("Searching the map {name}", { name: map });
    this._show(`${words} · ${t("{done} of {total}", { done: done + 1, total })}`, BAR.read + (1 - BAR.read) * (done / total));
  }

  /** @param {string} words @param {?number} share of the bar; null: unknown */
  _show(words, share) {
    if (this.what.textContent !== words) this.what.textContent = words;
    if (share === null) this.bar.removeAttribute("value");
    else this.bar.value = share;
  }

  _tick(seconds) {
    this.seconds.textContent = seconds >= SHOWN_FROM_S ? ` · ${t("{time} so far", { time: duration(Math.round(seconds)) })}` : "";
  }
}
