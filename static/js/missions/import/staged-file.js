/** A chosen file: uploaded, inspected, reread with other options, imported or dropped. */

import { sendInChunks } from "../../shared/send-chunks.js";
import { debounce } from "../../shared/timing.js";
import { ended } from "../job-progress.js";

const CALM_MS = 250;

/** Key of a source among those of a file. */
export const keyOf = ({ source, track }) => `${source}\n${track}`;

/**
 * @typedef {"sending"|"reading"|"ready"|"refused"|"importing"|"done"|"failed"} State
 */

/** Fires `change`; `contents` is what the server found in the file. */
export class StagedFile extends EventTarget {
  /**
   * @param {File} file
   * @param {Object} server endpoints of files
   */
  constructor(file, server) {
    super();
    this.file = file;
    this.server = server;
    /** @type {State} */
    this.state = "sending";
    this.sent = 0;
    this.job = null;
    /** @type {?{message: string, hint?: ?string}} */
    this.error = null;
    this.contents = null;
    this.result = null;
    /** Options of reading. */
    this.reading = { columns: "", axes: "", source: "" };
    /** Threshold for skipping poses that moved less, in the server's syntax; empty: the default. */
    this.minMove = "";
    this.unwanted = new Set();
    this._id = null;
    this._running = null; // id of the job that reads or imports the file
    this._turn = 0;
    this._stop = new AbortController();
    this._readSoon = debounce(() => this._read(), CALM_MS);
  }

  get name() {
    return this.file.name;
  }

  /** Whether the file was read, so that there is something to choose or correct. */
  get isUsable() {
    return this.contents !== null;
  }

  /** Sources that will be imported. */
  get wanted() {
    return this.contents?.sources.filter((one) => !this.unwanted.has(keyOf(one))) ?? [];
  }

  /** Those of them in the robot frame. */
  get inMetres() {
    return this.wanted.filter(({ frame }) => frame === "robot");
  }

  get isEmpty() {
    return !this.wanted.length && !this.contents?.objects;
  }

  /** Upload the file and read its contents. */
  async open() {
    try {
      await this._send();
      await this._read();
    } catch (error) {
      this._fail("refused", error);
    }
    if (this.state === "refused") this._drop();
  }

  /** Reread the file with other options. @param {Object} changes of the reading */
  readAs(changes) {
    Object.assign(this.reading, changes);
    this._become("reading");
    this._readSoon();
  }

  /** @param {Object} source @param {boolean} wanted */
  choose(source, wanted) {
    if (wanted) this.unwanted.delete(keyOf(source));
    else this.unwanted.add(keyOf(source));
    this._become(this.state);
  }

  /**
   * Import the file and return the id of its mission.
   * @param {Object} wish destination and options
   * @returns {Promise<?number>} null if it failed, with the reason in `error`
   */
  async bringIn(wish) {
    this.error = null;
    this.job = null;
    this._become("importing");
    try {
      if (this._id === null) await this._send(); // after a failed import the server has no file
      const chosen = this.unwanted.size ? this.wanted.map(({ source, track }) => ({ source, track })) : null;
      const { job } = await this.server.importFile(this._id, { name: this.name, ...this.reading, min_move: this.minMove, tracks: chosen, ...wish });
      this._id = null;
      const { result } = await this._ended(job);
      this.result = result;
      this._become("done");
      return result.mission;
    } catch (error) {
      this._fail("failed", error);
      return null;
    }
  }

  /** Discard the file and stop its requests. */
  close() {
    this._stop.abort();
    this._cancel();
    this._drop();
  }

  /** Cancel its job. */
  async _cancel() {
    const job = this._running;
    this._running = null;
    if (job !== null) await this.server.cancel(job).catch(() => {}); // the job may have ended meanwhile
  }

  _drop() {
    if (this._id !== null) this.server.drop(this._id).catch(() => {}); // the server cleans up otherwise
    this._id = null;
  }

  async _send() {
    await sendInChunks(this.file, {
      begin: async () => {
        const begun = await (this._id === null ? this.server.begin({ name: this.name, size_bytes: this.file.size }) : this.server.look(this._id));
        this._id = begun.id;
        return begun;
      },
      sendChunk: this.server.sendChunk,
      signal: this._stop.signal,
      onProgress: (bytes) => {
        this.sent = bytes;
        this._become(this.state);
      },
    });
  }

  /** Read the contents; an outdated response is ignored and its job cancelled. */
  async _read() {
    this._turn += 1;
    const turn = this._turn;
    this._become("reading");
    try {
      await this._cancel();
      if (turn !== this._turn) return;
      const asked = { ...this.reading };
      const answer = await this.server.contents(this._id, { name: this.name, ...asked });
      if (turn !== this._turn) {
        if (answer.job && !this._isRead(asked)) await this.server.cancel(answer.job);
        return;
      }
      const contents = answer.job ? (await this._ended(answer.job)).result : answer;
      if (turn !== this._turn) return;
      this.contents = contents;
      this.error = null;
      this._become("ready");
    } catch (error) {
      if (turn !== this._turn) return;
      this._fail(this.contents ? "ready" : "refused", error);
    }
  }

  /** Whether these are the present options: equal requests share one job, which must not be cancelled. */
  _isRead(reading) {
    return Object.entries(this.reading).every(([name, value]) => reading[name] === value);
  }

  async _ended(job) {
    this._running = job;
    const done = await ended(this.server.job, job, (state) => {
      this._stop.signal.throwIfAborted();
      if (this._running !== job) throw new DOMException("it is read in another way", "AbortError");
      this.job = state;
      this._become(this.state);
    }).catch((error) => {
      if (error.code === "job") this._running = null; // the job has ended
      throw error;
    });
    this._running = null;
    return done;
  }

  _fail(state, error) {
    if (error.name === "AbortError") return;
    this.error = error;
    this._become(state);
  }

  /** @param {State} state */
  _become(state) {
    this.state = state;
    this.dispatchEvent(new Event("change"));
  }
}
