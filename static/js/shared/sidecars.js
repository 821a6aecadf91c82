/** Files beside photos that may say where these were taken: `.xmp`, and the JSON of Google Takeout. */

import { isAmong } from "./accepted.js";

const MOST = 3;
const MOST_BYTES = 150000;
const CUT_AT = 40; // Google cuts off longer names

/** @param {File} file */
export function isSidecar(file) {
  return isAmong(file, "sidecars");
}

/**
 * Return the files that may belong to a photo, the likeliest first; the server knows which do.
 * @param {File} photo
 * @param {File[]} sidecars
 */
export function besidePhoto(photo, sidecars) {
  const stem = plain(photo.name).replace(/\.[^.]*$/, "");
  const core = stem.replace(/\(\d+\)$/, "").replace(/-\p{Letter}+$/u, "").slice(0, CUT_AT);
  const belongs = (file) => {
    const name = plain(file.name);
    const isCut = core.length >= CUT_AT;
    return folder(file) === folder(photo) && file.size <= MOST_BYTES
      && name.startsWith(core) && (isCut || !/[\p{Letter}\p{Number}]/u.test(name.charAt(core.length)));
  };
  // The nearest in length: that of `a-edited.jpg` may be that of `a.jpg`.
  const off = (file) => Math.abs(plain(file.name).length - stem.length) - (plain(file.name).startsWith(stem) ? 1000 : 0);
  return sidecars.filter(belongs).sort((a, b) => off(a) - off(b)).slice(0, MOST);
}

function plain(name) {
  return name.normalize("NFC").toLowerCase();
}

function folder({ webkitRelativePath: path = "" }) {
  return path.slice(0, path.lastIndexOf("/") + 1);
}
