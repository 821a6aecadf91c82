/** Tags of photos: the words of their notes that begin with #, as in "by the #gate". */

const TAG = /(?<![\p{L}\p{N}_#&/])#([\p{L}\p{N}_-]*\p{L}[\p{L}\p{N}_-]*)/gu;

/**
 * The tags of a note, each once, in small letters and without the #; a number such as #2 is none.
 * @param {?string} note
 * @returns {string[]}
 */
export function tagsOf(note) {
  return [...new Set([...(note ?? "").matchAll(TAG)].map(([, tag]) => tag.toLowerCase()))];
}

/**
 * How many of some photos have each tag, by name.
 * @param {Iterable<{note?: ?string}>} photos
 * @returns {Map<string, number>}
 */
export function countTags(photos) {
  const counts = new Map();
  for (const { note } of photos) for (const tag of tagsOf(note)) counts.set(tag, (counts.get(tag) ?? 0) + 1);
  return new Map([...counts].toSorted(([a], [b]) => a.localeCompare(b)));
}

/**
 * Change the tags of a note, and leave its other words as they are.
 * @param {?string} note
 * @param {{add?: string[], remove?: string[]}} tags without the #
 * @returns {string}
 */
export function retagged(note, { add = [], remove = [] }) {
  const gone = new Set(remove.map((tag) => tag.toLowerCase()));
  const kept = (note ?? "").replace(TAG, (word, tag) => (gone.has(tag.toLowerCase()) ? "" : word));
  const tidy = gone.size ? kept.replace(/[^\S\n]{2,}/g, " ").replace(/[^\S\n]+$/gm, "").trim() : kept;
  const there = new Set(tagsOf(tidy));
  const missing = [...new Set(add.map((tag) => tag.toLowerCase()))].filter((tag) => !there.has(tag));
  return [tidy, ...missing.map((tag) => `#${tag}`)].filter(Boolean).join(" ");
}
