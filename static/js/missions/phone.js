/** The page that sends the position of the phone that it is open on. */

import { post } from "../shared/api.js";
import { byId } from "../shared/dom.js";
import { locale, t } from "../shared/i18n.js";
import { sentence } from "../shared/toast.js";
import { lengthText } from "./format.js";
import { PositionQueue } from "./position-queue.js";
import { metresBetween } from "./track-points.js";

const EVERY_MS = 5000;
const SEND_MS = 5000;
const NEAR_M = 10;
const ON = "expmap-phone-on";

const { token } = JSON.parse(byId("page").textContent);
const problems = { position: null, sending: null };
const button = byId("share-position", HTMLButtonElement);

class Sharing {
  /** @param {PositionQueue} queue */
  constructor(queue) {
    this.queue = queue;
    this.watch = null;
    this.last = null;
    this.sending = false;
    this.lock = null;
  }

  get isOn() {
    return this.watch !== null;
  }

  start() {
    problem("position", null);
    this.watch = navigator.geolocation.watchPosition(
      (found) => this._take(found).catch((error) => problem("position", error.message)),
      (error) => this._failed(error),
      { enableHighAccuracy: true, maximumAge: 1000 },
    );
    localStorage.setItem(ON, token);
    this.stayAwake();
    this._show();
  }

  stop() {
    navigator.geolocation.clearWatch(this.watch);
    this.watch = null;
    localStorage.removeItem(ON);
    this.lock?.release();
    this._show();
    this.send();
  }

  /** Keep the screen on: browsers give no positions to a page that nobody sees. They end the lock when it is hidden. */
  async stayAwake() {
    if (!this.isOn || !navigator.wakeLock || document.hidden) return;
    try {
      this.lock = await navigator.wakeLock.request("screen");
    } catch (error) {
      console.info(`the screen may turn off: ${error.message}`); // as when the battery is low
    }
  }

  /** Keep a position unless it says little more than the last one. */
  async _take({ coords, timestamp }) {
    const position = {
      time: timestamp / 1000, lat: coords.latitude, lon: coords.longitude,
      height_m: coords.altitude, accuracy_m: coords.accuracy,
    };
    problem("position", null);
    byId("position-accuracy").textContent = lengthText(coords.accuracy);
    if (this.last && timestamp - this.last.time * 1000 < EVERY_MS && metresBetween([this.last.lat, this.last.lon], [position.lat, position.lon]) < NEAR_M) return;
    this.last = position;
    await this.queue.add(position);
    await this._count();
    this.send();
  }

  _failed(error) {
    if (error.code !== error.PERMISSION_DENIED) return problem("position", t("The phone does not know its position yet."));
    this.stop();
    problem("position", t("The browser may not know the position: allow it in the settings of this page."));
  }

  /** Send what waits, oldest first. */
  async send() {
    if (this.sending) return;
    this.sending = true;
    try {
      for (let batch = await this.queue.batch(); batch; batch = await this.queue.batch()) await this._send(batch);
    } catch (error) {
      if (!("code" in error)) throw error;
      this._refused(error);
    } finally {
      this.sending = false;
      await this._count();
    }
  }

  async _send(batch) {
    try {
      const { next } = await post(`/phones/${token}/positions`, batch);
      await this.queue.stored(next);
    } catch (error) {
      if (error.status !== 409 || error.next === null) throw error;
      if (error.next > batch.first) await this.queue.stored(error.next);
      else await this.queue.restart();
    }
    problem("sending", null);
    byId("position-sent").textContent = new Date().toLocaleTimeString(locale);
  }

  /** Without a network there is nothing to say: the number of those that wait does. */
  _refused(error) {
    if (error.code === "offline") return;
    if (error.status === 404 && this.isOn) this.stop();
    problem("sending", [error.message, error.hint].filter(Boolean).map(sentence).join(". "));
  }

  async _count() {
    byId("position-waiting").textContent = (await this.queue.count()).toLocaleString(locale);
  }

  _show() {
    button.setAttribute("aria-pressed", String(this.isOn));
    button.classList.toggle("button--primary", !this.isOn);
    button.querySelector("span").textContent = this.isOn ? t("Stop sharing") : t("Share my position");
    byId("position-state").textContent = this.isOn ? t("Your position is shared.") : "";
  }
}

/** Show what is wrong, or that it no longer is. @param {"position"|"sending"} part @param {?string} text */
function problem(part, text) {
  problems[part] = text;
  const all = Object.values(problems).filter(Boolean).join(" ");
  const note = byId("position-problem");
  note.hidden = !all;
  if (note.querySelector("div").textContent !== all) note.querySelector("div").textContent = all;
}

async function begin() {
  if (!navigator.geolocation || !isSecureContext) {
    problem("position", t("Browsers give the position to pages over https only: ask for an address that begins with https."));
    return;
  }
  const sharing = new Sharing(await PositionQueue.open(token));
  button.disabled = false;
  button.addEventListener("click", () => (sharing.isOn ? sharing.stop() : sharing.start()));
  addEventListener("online", () => sharing.send());
  document.addEventListener("visibilitychange", () => sharing.stayAwake());
  setInterval(() => sharing.send(), SEND_MS);
  if (localStorage.getItem(ON) === token) sharing.start(); // it was on when the page was closed
  await sharing.send();
}

begin().catch((error) => problem("position", error.message));
