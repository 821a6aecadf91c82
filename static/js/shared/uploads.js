/**
 * Uploads files: a few at a time, in chunks, resuming where they stopped.
 *
 * The server identifies a partial upload by its fingerprint: choosing the same files after a reload resumes it.
 * Files that are already in the map are not sent again.
 */

import { post, upload } from "./api.js";
import { t } from "./i18n.js";
import { besidePhoto, isSidecar } from "./sidecars.js";
import { sendInChunks } from "./send-chunks.js";

const PARALLEL = 3;
const REMEMBERED = 5000;
const byName = new Intl.Collator(undefined, { numeric: true }).compare;

/**
 * The server's endpoints for uploads.
 * @param {string} slug of the map
 */
export function uploadEndpoints(slug) {
  const uploads = `/maps/${encodeURIComponent(slug)}/uploads`;
  return {
    beginUpload: (about) => post(uploads, about),
    sendChunk: (id, chunk, options) => upload(`${uploads}/${id}`, { method: "PATCH", body: chunk, ...options }),
  };
}

/**
 * The known photos of a map; empty for an empty map.
 * @typedef {{slug: string, photos: Map<number, {name: string}>, isPlaced: function(number): boolean}} KnownPhotos
 */

/**
 * @typedef {Object} Entry
 * @property {File} file
 * @property {File[]} beside files that may say where it was taken
 * @property {"waiting"|"sending"|"done"|"failed"|"cancelled"} state
 * @property {number} sent bytes sent
 * @property {?{message: string, hint: ?string}} error
 * @property {?{id: number, placed: boolean, duplicate: boolean, gps_problem: ?string, is_plan: boolean}} result
 */

/** The files of this page view; fires `progress` often and `finished` at the end. */
export class Uploads extends EventTarget {
  /**
   * @param {Object} server endpoints
   * @param {KnownPhotos} store
   */
  constructor(server, store) {
    super();
    this.server = server;
    this.store = store;
    this.entries = [];
    this.begunAt = 0;
    this._running = 0;
    this._stop = new AbortController();
    /** @type {Promise<unknown>} */
    this._turn = Promise.resolve();
    this._known = new Known(store.slug);
    addEventListener("beforeunload", (event) => this.busy && event.preventDefault());
  }

  get busy() {
    return this._running > 0;
  }

  /**
   * Files beside photos are sent with these; others of them are left out.
   * @param {File[]} files
   */
  add(files) {
    if (!this.busy) {
      this.entries = [];
      this.begunAt = performance.now();
      this._stop = new AbortController();
    }
    const there = new Set(this.entries.map(({ file }) => fingerprint(file)));
    const [sidecars, photos] = [files.filter(isSidecar), files.filter((file) => !isSidecar(file))];
    const fresh = photos.filter((file) => !there.has(fingerprint(file))).sort((a, b) => byName(a.name, b.name));
    const entry = { state: "waiting", sent: 0, error: null, result: null };
    const added = fresh.map((file) => ({ ...entry, file, beside: besidePhoto(file, sidecars) }));
    const used = new Set(photos.flatMap((file) => besidePhoto(file, sidecars)));
    const alone = sidecars.filter((file) => /\.xmp$/i.test(file.name) && !used.has(file));
    const error = { message: t("This file belongs to a photo: choose both together."), hint: null, status: 422 };
    this.entries.push(...added, ...alone.map((file) => ({ ...entry, file, beside: [], state: "failed", error })));
    this._fill();
    this._tell();
  }

  /** Stop; what has arrived stays, and choosing the files again resumes. */
  cancel() {
    for (const entry of this.entries) if (entry.state === "waiting") entry.state = "cancelled";
    this._stop.abort();
    this._tell();
  }

  /** Retry files that may succeed. */
  retry() {
    const files = this.entries.filter(canGoAgain).flatMap(({ file, beside }) => [file, ...beside]);
    this.entries = this.entries.filter((entry) => !canGoAgain(entry));
    this.add(files);
  }

  _tell() {
    this.dispatchEvent(new Event("progress"));
  }

  _fill() {
    while (this._running < PARALLEL) {
      const entry = this.entries.find(({ state }) => state === "waiting");
      if (!entry) return;
      this._running += 1;
      entry.state = "sending";
      this._one(entry).finally(() => {
        this._running -= 1;
        this._fill();
        this._tell();
        if (!this._running) this.dispatchEvent(new Event("finished"));
      });
    }
  }

  async _one(entry) {
    const known = this._known.photo(entry.file);
    // Compare the name: a new map may reuse the slug and the ids of a deleted one.
    if (known !== null && this.store.photos.get(known)?.name === entry.file.name) {
      const placed = this.store.isPlaced(known);
      return Object.assign(entry, { state: "done", sent: entry.file.size, result: { id: known, placed, duplicate: true } });
    }
    try {
      entry.result = await this._send(entry);
      entry.state = "done";
      entry.sent = entry.file.size;
      this._known.remember(entry.file, entry.result.id);
    } catch (error) {
      entry.state = error.name === "AbortError" ? "cancelled" : "failed";
      entry.error = error;
    }
    return entry;
  }

  async _send(entry) {
    const { file } = entry;
    const beside = await Promise.all(entry.beside.map(async (one) => ({ name: one.name, content: await one.text() })));
    const about = { name: file.name, size_bytes: file.size, fingerprint: fingerprint(file), beside };
    return sendInChunks(file, {
      begin: () => this._inTurn(() => this.server.beginUpload(about)),
      sendChunk: this.server.sendChunk,
      signal: this._stop.signal,
      onProgress: (sent) => {
        entry.sent = sent;
        this._tell();
      },
    });
  }

  /**
   * Begin uploads one by one, as photos get their ids in this order; their bytes are sent in parallel.
   *
   * @template T
   * @param {() => Promise<T>} begin
   * @returns {Promise<T>}
   */
  _inTurn(begin) {
    const turn = this._turn.then(begin);
    this._turn = turn.catch(() => {});
    return turn;
  }
}

/** Whether sending a file again may help: it was cancelled, or failed for a reason other than its content. */
export function canGoAgain({ state, error }) {
  return state === "cancelled" || (state === "failed" && ![400, 413, 415, 422].includes(error.status));
}

/** Key that identifies a file after a reload. */
export function fingerprint({ name, size, lastModified }) {
  return `${name.slice(-300)}|${size}|${lastModified}`;
}

/** Ids of photos by the fingerprint of their file, kept in this browser. */
class Known {
  constructor(slug) {
    this.key = `expmap.uploaded.${slug}`;
    this.ids = new Map(JSON.parse(localStorage.getItem(this.key) || "[]"));
  }

  photo(file) {
    return this.ids.get(fingerprint(file)) ?? null;
  }

  remember(file, id) {
    this.ids.set(fingerprint(file), id);
    localStorage.setItem(this.key, JSON.stringify([...this.ids].slice(-REMEMBERED)));
  }
}
