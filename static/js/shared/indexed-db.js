/** What the stores of this browser in IndexedDB share. */

/** The result of a request, as a promise. @param {IDBRequest} request @returns {Promise<*>} */
export function resultOf(request) {
  return new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
}

/**
 * Change a store; when the promise resolves, the change is on disk.
 * @param {IDBDatabase} database
 * @param {string} name
 * @param {function(IDBObjectStore): void} run
 */
export async function write(database, name, run) {
  const transaction = database.transaction(name, "readwrite", { durability: "strict" });
  run(transaction.objectStore(name));
  await new Promise((resolve, reject) => {
    transaction.oncomplete = resolve;
    transaction.onabort = () => reject(transaction.error);
  });
}

/** A random name, by which the server recognises what is sent twice. */
export function randomName() {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}
