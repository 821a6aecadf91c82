/** What a page of a large map begins without: the details of most photos, some thousand at a time. */

const PAGE = 5000;
const RETRY_MS = 10000;

/**
 * Ask for all details that are missing, and for those of the current photo before the others.
 * @param {import("./map-store.js").MapStore} store
 * @param {function(number, number): Promise<{photos: Object[], next: ?number}>} photosAfter an id, at most so many
 */
export async function loadDetails(store, photosAfter) {
  if ([...store.photos.keys()].every((id) => store.isKnown(id))) return;
  const current = async () => {
    const { currentId } = store;
    if (currentId === null || store.isKnown(currentId)) return;
    store.addDetails((await photosAfter(currentId - 1, 1)).photos);
  };
  const ask = () => current().catch(() => {}); // it comes with all others
  store.on("current", ask);
  ask();
  for (let after = -1; after !== null; ) {
    const page = await persistently(() => photosAfter(after, PAGE));
    store.addDetails(page.photos);
    after = page.next;
  }
}

/** Ask until there is an answer: the network may be away, or the server busy. */
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
