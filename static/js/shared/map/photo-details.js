/** Loads the details of photos that the page of a large map does not contain, in batches. */

const PAGE = 5000;
const RETRY_MS = 10000;

/**
 * Load all missing details, those of the current photo first.
 * @param {import("./map-store.js").MapStore} store
 * @param {function(number, number): Promise<{photos: Object[], next: ?number}>} photosAfter photos after an id, up to a number of them
 */
export async function loadDetails(store, photosAfter) {
  if ([...store.photos.keys()].every((id) => store.isKnown(id))) return;
  const current = async () => {
    const { currentId } = store;
    if (currentId === null || store.isKnown(currentId)) return;
    store.addDetails((await photosAfter(currentId - 1, 1)).photos);
  };
  const ask = () => current().catch(() => {}); // it is loaded with the others
  store.on("current", ask);
  ask();
  for (let after = -1; after !== null; ) {
    const page = await persistently(() => photosAfter(after, PAGE));
    store.addDetails(page.photos);
    after = page.next;
  }
}

/** Repeat a request while the network or the server fails. */
async function persistently(ask) {
  for (;;) {
    try {
      return await ask();
    } catch (error) {
      if (error.status !== 0 && error.status < 500) throw error;
      await new Promise((resolve) => setTimeout(resolve, RETRY_MS));
    }
  }
}
