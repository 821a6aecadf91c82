/** The address of the page follows the photo: a link opens it again, and Back returns to where one has jumped from. */

const NAME = "photo";

/** The photo in the address; null if there is none. @returns {?number} */
export function photoInAddress() {
  const text = new URLSearchParams(location.search).get(NAME);
  return text === null || !/^\d+$/.test(text) ? null : Number(text);
}

/** Write a photo into the address. @param {number} id @param {"pushState"|"replaceState"} how */
export function writeAddress(id, how) {
  const url = new URL(location.href);
  if (url.searchParams.get(NAME) === String(id)) return;
  url.searchParams.set(NAME, String(id));
  history[how](null, "", url);
}
