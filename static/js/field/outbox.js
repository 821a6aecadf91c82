/**
 * Photos waiting to be sent, and answers received, in IndexedDB, so that closing the page loses nothing.
 */

import { randomName, resultOf, write } from "../shared/indexed-db.js";

/** @typedef {{key: string, account: number, map: string, name: string, at: string, photo: ?Blob, thumb: ?Blob,
 *   state: "waiting"|"answered"|"added"|"refused", answer: ?Object, error: ?string,
 *   spot: ?import("./guide.js").Target}} Entry a photo with a `spot` is added to the map, any other is localized */

const DATABASE = "expmap-field";
const STORE = "photos";
const THUMB = 256;

/** Photos of one account; fires `change`, also when another tab changed something. */
export class Outbox extends EventTarget {
  /**
   * @param {IDBDatabase} database
   * @param {number} account
   */
  constructor(database, account) {
    super();
    this.database = database;
    this.account = account;
    this.channel = "BroadcastChannel" in self ? new BroadcastChannel(DATABASE) : null;
    if (this.channel) this.channel.onmessage = () => this.dispatchEvent(new Event("change"));
  }

  /** Open the outbox of an account. @param {number} account @returns {Promise<Outbox>} */
  static async open(account) {
    const asked = indexedDB.open(DATABASE, 1);
    asked.onupgradeneeded = () => asked.result.createObjectStore(STORE, { keyPath: "key" });
    return new Outbox(await resultOf(asked), account);
  }

  /**
   * Add photos; when the promise resolves, they are on disk.
   * @param {File[]} files
   * @param {string} map slug
   * @param {{spot?: ?import("./guide.js").Target}} [of]
   */
  async add(files, map, { spot = null } = {}) {
    const at = new Date().toISOString();
    const entries = await Promise.all([...files].map(async (file, n) => ({
      key: randomName(), account: this.account, map, name: file.name || "photo.jpg", at, n,
      photo: file, thumb: await thumbOf(file), state: "waiting", answer: null, error: null, spot,
    })));
    await this._write((store) => entries.forEach((entry) => store.put(entry)));
  }

  /** All photos of the account, the oldest first. @returns {Promise<Entry[]>} */
  async all() {
    const found = await resultOf(this.database.transaction(STORE).objectStore(STORE).getAll());
    const mine = found.filter(({ account }) => account === this.account);
    return mine.sort((a, b) => (a.at < b.at ? -1 : a.at > b.at ? 1 : a.n - b.n));
  }

  /** Change fields of a photo, unless it was removed meanwhile. @param {string} key @param {Object} fields */
  change(key, fields) {
    return this._write((store) => {
      const asked = store.get(key);
      asked.onsuccess = () => asked.result && store.put({ ...asked.result, ...fields });
    });
  }

  /** @param {string[]} keys */
  remove(keys) {
    return this._write((store) => keys.forEach((key) => store.delete(key)));
  }

  async _write(run) {
    await write(this.database, STORE, run);
    this.channel?.postMessage("change");
    this.dispatchEvent(new Event("change"));
  }
}

/** A thumbnail for the list; null if the browser cannot decode the format. */
async function thumbOf(file) {
  try {
    const large = await createImageBitmap(file);
    const scale = Math.min(1, THUMB / Math.max(large.width, large.height));
    const canvas = document.createElement("canvas");
    canvas.width = Math.max(1, Math.round(large.width * scale));
    canvas.height = Math.max(1, Math.round(large.height * scale));
    canvas.getContext("2d").drawImage(large, 0, 0, canvas.width, canvas.height);
    large.close();
    return await new Promise((resolve) => canvas.toBlob(resolve, "image/jpeg", 0.8));
  } catch (error) {
    if (error.name === "InvalidStateError") return null;
    throw error;
  }
}
