/** The texts of photos that people edit (notes ...), which the page lists (`#written`). */

/** @typedef {{name: string, kind: string, label: string, most: number, lines: boolean}} WrittenFact `kind` of its edits; one line or `lines` */

/** @type {WrittenFact[]} */
export const WRITTEN = JSON.parse(document.getElementById("written")?.textContent ?? "[]");
