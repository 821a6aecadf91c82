/** Tags of photos: the words of their notes that begin with #, as in "by the #gate". */

const TAG = /(?<![\p{L}\p{N}_#&/])#([\p{L}\p{N}_-]*\p{L}[\p{L}\p{N}_-]*)/gu;

/**
 * The distinct tags of a note, in lower case without the #; a number such as #2 is no tag.
 * @param {?string} note
 * @returns {string[]}
 */
export function tagsOf(note) {
  return [...new Set([...(note ?? "").matchAll(TAG)].map(([, tag]) => tag.toLowerCase()))];
}

/**
 * Count equal texts; in alphabetical order.
 * @param {string[]} texts
 * @returns {Map<string, number>}
 */
export function countEach(texts) {
  const counts = new Map();
  for (const text of texts) counts.set(text, (counts.get(text) ?? 0) + 1);
  return new Map([...counts].toSorted(([a], [b]) => a.localeCompare(b)));
}

/**
 * Number of photos with each tag.
 * @param {Array<{note?: ?string}>} photos
 */
export const countTags = (photos) => countEach(photos.flatMap(({ note }) => tagsOf(note)));

/**
 * Change the tags of a note without changing its other words.
 * @param {?string} note
 * @param {{add?: string[], remove?: string[]}} tags without the #
 * @returns {string}
 */
export function retagged(note, { add = [], remove = [] }) {
  const gone = new Set(remove.map((tag) => tag.toLowerCase()));
  const kept = (note ?? "").replace(TAG, (word, tag) => (gone.has(tag.toLowerCase()) ? "" : word));
  const tidy = kept !== (note ?? "") ? kept.replace(/[^\S\n]{2,}/g, " ").replace(/[^\S\n]+$/gm, "").trim() : kept;
  const there = new Set(tagsOf(tidy));
  const missing = [...new Set(add.map((tag) => tag.toLowerCase()))].filter((tag) => !there.has(tag));
  return [tidy, ...missing.map((tag) => `#${tag}`)].filter(Boolean).join(" ");
}
