/** Messages that outlive the page on which they came up: the next page of the map shows them. */

const KEY = "expmap-notes";

/** @typedef {{kind: "success"|"warning", text: string}} Note */

/** @param {Note[]} notes */
export function keepNotes(notes) {
  sessionStorage.setItem(KEY, JSON.stringify(notes));
}

/** Take what was kept. @returns {Note[]} */
export function takeNotes() {
  const kept = JSON.parse(sessionStorage.getItem(KEY) || "[]");
  sessionStorage.removeItem(KEY);
  return kept;
}
