/** Localizes the photo of a visitor, and shows its answer or why there is none. */

import { WaitingWords } from "../shared/answer/waiting-words.js";
import { upload } from "../shared/api.js";
import { byId } from "../shared/dom.js";
import { labelled, t } from "../shared/i18n.js";
import { note, sentence } from "../shared/toast.js";

const AGAIN_MS = 15_000;

/** Sends one photo at a time; a newer one cancels it. While the map is not ready, the photo waits and is sent again. */
export class VisitorPhoto {
  /**
   * @param {import("../shared/answer/query-session.js").QuerySession} session
   * @param {string} path of the request
   */
  constructor(session, path) {
    this.session = session;
    this.path = path;
    this.words = new WaitingWords(byId("busy-words"), byId("busy", HTMLProgressElement));
    this._abort = new AbortController();
    const input = byId("query-input", HTMLInputElement);
    input.addEventListener("change", () => {
      const [file] = input.files;
      input.value = ""; // the same file can be chosen again
      if (file) this._take(file);
    });
    const [frame, image] = [byId("query-frame"), byId("query-image")];
    image.addEventListener("error", () => frame.classList.add("is-broken"));
    image.addEventListener("load", () => frame.classList.remove("is-broken"));
  }

  /** @param {File} file */
  async _take(file) {
    this._abort.abort();
    this._abort = new AbortController();
    const name = file.name || "photo.jpg";
    this._begin({ name, url: URL.createObjectURL(file) });
    await this._send(file, name);
  }

  /** @param {File} file @param {string} name */
  async _send(file, name) {
    const { signal } = this._abort;
    const body = new FormData();
    body.append("file", file, name);
    try {
      const answer = await upload(this.path, { body, signal, ...this._listeners(signal) });
      if (signal.aborted) return;
      byId("notes").replaceChildren();
      this.session.setAnswer(answer);
    } catch (error) {
      if (signal.aborted) return;
      if (error.code === "not_ready") {
        this._later(error, () => signal.aborted || this._send(file, name));
        return;
      }
      this._failed(name, error);
    }
    if (!signal.aborted) this.words.end();
  }

  /** Show the photo; what was said about the one before leaves. */
  _begin(query) {
    byId("query-frame").classList.remove("is-broken");
    byId("notes").replaceChildren();
    this.session.setAnswer(null);
    this.session.setQuery(query);
    this.words.begin(true);
    byId("side").scrollTop = 0;
    byId("query-frame").scrollIntoView({ block: "nearest" }); // in a low window it is below the map
  }

  /** @param {AbortSignal} signal */
  _listeners(signal) {
    return {
      onProgress: (sent, all) => !signal.aborted && this.words.sent(sent, all),
      onEvent: (kind, data) => {
        if (signal.aborted) return;
        this.words.take(kind, data);
        if (kind === "first") this.session.setAnswer(data);
      },
    };
  }

  /** @param {Error} error @param {function(): void} again */
  _later({ message }, again) {
    this.words.waitForIndex();
    byId("notes").replaceChildren(note("info", sentence(message), t("Leave this page open: the photo is localized as soon as the map is ready.")));
    setTimeout(again, AGAIN_MS);
  }

  /** @param {string} name of the photo @param {Error & {hint?: ?string}} error */
  _failed(name, { message, hint }) {
    this.session.setAnswer(null); // the first look may have given one
    byId("notes").replaceChildren(note("danger", labelled(name, message), hint && sentence(hint)));
    byId("notes").scrollIntoView({ block: "nearest" });
  }
}
