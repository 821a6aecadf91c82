/** Messages that the next page of the map shows. */

const KEY = "expmap-notes";

/** @typedef {{kind: "success"|"warning", text: string}} Note */

/** @param {Note[]} notes */
export function keepNotes(notes) {
  sessionStorage.setItem(KEY, JSON.stringify(notes));
}

/** Return the kept messages and forget them. @returns {Note[]} */
export function takeNotes() {
  const kept = JSON.parse(sessionStorage.getItem(KEY) || "[]");
  sessionStorage.removeItem(KEY);
  return kept;
}
