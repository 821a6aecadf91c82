/** What file fields accept, by what is chosen; the server states it from the formats that it reads. */

/** @type {Record<string, string>} */
export const ACCEPTED = JSON.parse(document.getElementById("accepted").textContent);

/**
 * Whether a file is among what a field accepts, by its suffix.
 * @param {{name: string}} file
 * @param {string} what
 */
export function isAmong({ name }, what) {
  const lower = name.toLowerCase();
  return ACCEPTED[what].split(",").some((part) => part.startsWith(".") && lower.endsWith(part));
}
