/** The address of the page follows the photo: a link opens it again, and Back returns to where one has jumped from. */

const NAME = "photo";

/** The photo in the address; null if there is none. @returns {?number} */
export function photoInAddress() {
  const text = new URLSearchParams(location.search).get(NAME);
  return text === null || !/^\d+$/.test(text) ? null : Number(text);
}

/** The order of the photos in the address. @returns {import("./walk.js").Order} */
export function orderInAddress() {
  return new URLSearchParams(location.search).get("order") === "place" ? "by_place" : "by_time";
}

/** Write an order into the address; that by time needs no word. @param {import("./walk.js").Order} order */
export function writeOrder(order) {
  const url = new URL(location.href);
  if (order === "by_place") url.searchParams.set("order", "place");
  else url.searchParams.delete("order");
  history.replaceState(null, "", url);
}

/** Write a photo into the address. @param {number} id @param {"pushState"|"replaceState"} how */
export function writeAddress(id, how) {
  const url = new URL(location.href);
  if (url.searchParams.get(NAME) === String(id)) return;
  url.searchParams.set(NAME, String(id));
  history[how](null, "", url);
}
