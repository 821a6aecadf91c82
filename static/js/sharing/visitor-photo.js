/** Localizes the photo of a visitor, and shows its answer or why there is none. */

import { WaitingWords } from "../shared/answer/waiting-words.js";
import { upload } from "../shared/api.js";
import { byId } from "../shared/dom.js";
import { labelled } from "../shared/i18n.js";
import { note, sentence } from "../shared/toast.js";

/** Sends one photo at a time; a newer one cancels it. */
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
    const { signal } = this._abort;
    const name = file.name || "photo.jpg";
    this._begin({ name, url: URL.createObjectURL(file) });
    const body = new FormData();
    body.append("file", file, name);
    try {
      const answer = await upload(this.path, { body, signal, ...this._listeners(signal) });
      if (!signal.aborted) this.session.setAnswer(answer);
    } catch (error) {
      if (!signal.aborted) this._failed(name, error);
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

  /** @param {string} name of the photo @param {Error & {hint?: ?string}} error */
  _failed(name, { message, hint }) {
    this.session.setAnswer(null); // the first look may have given one
    byId("notes").replaceChildren(note("danger", labelled(name, message), hint && sentence(hint)));
    byId("notes").scrollIntoView({ block: "nearest" });
  }
}
