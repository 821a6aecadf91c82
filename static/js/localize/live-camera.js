/**
 * The live camera: frames are localized one at a time, and the marker follows.
 * The server treats them as one sequence, in which earlier frames serve as evidence for later ones.
 * No frame is stored, unless the user keeps the last one.
 */

import { byId, h, iconAddress } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { note, sentence } from "../shared/toast.js";

const LONGER_SIDE = 1024;
const QUALITY = 0.85;
const PAUSE_MS = 100;
const AFTER_ERROR_MS = 1500;

/** Localizes the frames of the camera while it is on. */
export class LiveCamera {
  /** @param {{session: import("../shared/answer/query-session.js").QuerySession, server: Object, options: Object, asking: Object}} page */
  constructor({ session, server, options, asking }) {
    this.session = session;
    this.server = server;
    this.options = options;
    this.asking = asking;
    this.stream = null;
    this.last = null;
    this.video = byId("video", HTMLVideoElement);
    this.canvas = document.createElement("canvas");
    byId("live").addEventListener("click", () => (this.stream ? this.stop() : this.start()));
    addEventListener("pagehide", () => this.stop());
    byId("live").hidden = !navigator.mediaDevices?.getUserMedia; // only available with https
  }

  async start() {
    const wanted = { video: { facingMode: "environment", width: { ideal: 1280 } }, audio: false };
    try {
      this.stream = await navigator.mediaDevices.getUserMedia(wanted);
    } catch (error) {
      byId("notes").replaceChildren(note("danger", t("The camera cannot be used."), refusal(error)));
      return;
    }
    this.asking.cancel();
    this.session.setAnswer(null);
    this.session.setQuery(null);
    history.replaceState(null, "", location.pathname);
    this.last = null;
    this.sequence = crypto.randomUUID();
    this.session.setLive(true);
    this._button();
    this.video.srcObject = this.stream;
    await this.video.play();
    for (const track of this.stream.getTracks()) track.addEventListener("ended", () => this.stop());
    this._loop(this.stream);
  }

  /** Stop the camera; the last picture and its answer stay. */
  stop() {
    if (!this.stream) return;
    for (const track of this.stream.getTracks()) track.stop();
    this.stream = null;
    this.video.srcObject = null;
    const { last } = this;
    if (last) {
      const keep = h("button", { class: "button", type: "button", onclick: () => this.asking.ask([last]) }, t("Keep this photo and its answer"));
      this.session.setQuery({ name: t("The last picture"), url: URL.createObjectURL(last) });
      byId("notes").replaceChildren(keep);
    }
    this.session.setLive(false);
    this._button();
  }

  async _loop(stream) {
    while (this.stream === stream) {
      let pause = PAUSE_MS;
      try {
        const frame = document.hidden ? null : await this._frame();
        const answer = frame && (await this.server.ask([frame], { ...this.options.values(), keep: false, sequence: this.sequence }));
        if (this.stream !== stream) return;
        if (answer) this._follow(answer, frame);
      } catch (error) {
        if (this.stream !== stream) return;
        byId("notes").replaceChildren(note("danger", sentence(error.message), error.hint && sentence(error.hint)));
        pause = AFTER_ERROR_MS;
      }
      await new Promise((resolve) => setTimeout(resolve, pause));
    }
  }

  /** The current frame as a JPEG file; null before the first one. */
  _frame() {
    const { videoWidth: width, videoHeight: height } = this.video;
    if (!width) return null;
    const scale = Math.min(1, LONGER_SIDE / Math.max(width, height));
    Object.assign(this.canvas, { width: Math.round(width * scale), height: Math.round(height * scale) });
    this.canvas.getContext("2d").drawImage(this.video, 0, 0, this.canvas.width, this.canvas.height);
    return new Promise((resolve) => {
      this.canvas.toBlob((blob) => resolve(blob && new File([blob], "live.jpg", { type: "image/jpeg" })), "image/jpeg", QUALITY);
    });
  }

  _follow(answer, frame) {
    this.last = frame;
    byId("notes").replaceChildren();
    this.session.setAnswer(answer);
  }

  _button() {
    const on = Boolean(this.stream);
    byId("live").setAttribute("aria-pressed", String(on));
    byId("live").classList.toggle("is-on", on);
    byId("live-label").textContent = on ? t("Stop") : t("Live camera");
    byId("live").querySelector("use").setAttribute("href", iconAddress(on ? "stop" : "video"));
  }
}

function refusal({ name }) {
  if (name === "NotAllowedError") return t("Allow camera access for this page in the browser settings.");
  if (name === "NotFoundError") return t("This device has no camera.");
  return t("Is another program using it?");
}
