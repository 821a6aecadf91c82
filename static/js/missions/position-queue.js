/**
 * Positions of a phone that wait to be sent, in IndexedDB, so that closing the page loses none.
 *
 * They are numbered without gaps, by which the server stores each exactly once: see `POST /phones/TOKEN/positions`.
 */

import { randomName, resultOf, write } from "../shared/indexed-db.js";

/** @typedef {{time: number, lat: number, lon: number, height_m: ?number, accuracy_m: ?number}} Position */

const STORE = "positions";
const SENDER = "sender";
const AT_ONCE = 500;

/** The queue of one link. */
export class PositionQueue {
  /** @param {IDBDatabase} database */
  constructor(database) {
    this.database = database;
  }

  /** @param {string} token of the link @returns {Promise<PositionQueue>} */
  static async open(token) {
    const asked = indexedDB.open(`expmap-phone-${token}`, 1);
    asked.onupgradeneeded = () => {
      asked.result.createObjectStore(STORE, { autoIncrement: true });
      asked.result.createObjectStore(SENDER);
    };
    return new PositionQueue(await resultOf(asked));
  }

  /** Add a position; when the promise resolves, it is on disk. @param {Position} position */
  add(position) {
    return write(this.database, STORE, (store) => store.add(position));
  }

  /** @returns {Promise<number>} */
  count() {
    return resultOf(this.database.transaction(STORE).objectStore(STORE).count());
  }

  /**
   * The oldest positions, as the server takes them; null if there are none.
   * @returns {Promise<?{sender: string, first: number, positions: Position[]}>}
   */
  async batch() {
    const transaction = this.database.transaction(STORE);
    const store = transaction.objectStore(STORE);
    const [keys, positions] = await Promise.all([resultOf(store.getAllKeys(null, AT_ONCE)), resultOf(store.getAll(null, AT_ONCE))]);
    if (!keys.length) return null;
    const { name, before } = (await this._sender()) ?? (await this.restart());
    return { sender: name, first: Number(keys[0]) - before, positions };
  }

  /** Remove what the server has stored: positions before a number. @param {number} next */
  async stored(next) {
    const { before } = await this._sender();
    await write(this.database, STORE, (store) => store.delete(IDBKeyRange.upperBound(next + before, true)));
  }

  /** Number what waits from 0 on, under a new name: the server does not know the old one. */
  async restart() {
    const [first] = await resultOf(this.database.transaction(STORE).objectStore(STORE).getAllKeys(null, 1));
    const sender = { name: randomName(), before: Number(first) };
    await write(this.database, SENDER, (store) => store.put(sender, SENDER));
    return sender;
  }

  _sender() {
    return resultOf(this.database.transaction(SENDER).objectStore(SENDER).get(SENDER));
  }
}
