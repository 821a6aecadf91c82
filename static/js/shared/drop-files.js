/** Files that are dropped, pasted or chosen: folders are walked, system files are left out. */

import { takesText } from "./dom.js";
import { t } from "./i18n.js";

const UNNAMED = "image.png";
const SYSTEM = /^(\.|thumbs\.db$|desktop\.ini$|ehthumbs)/i;

/**
 * Listen to files that are dropped anywhere on the page.
 * @param {HTMLElement} shade shown while files are over the page
 * @param {function(File[]): void} take
 */
export function listenToDrops(shade, take) {
  let depth = 0;
  const hasFiles = (event) => [...(event.dataTransfer?.types || [])].includes("Files");
  const over = (change) => {
    depth = Math.max(0, depth + change);
    shade.hidden = depth === 0;
  };
  addEventListener("dragenter", (event) => hasFiles(event) && over(1));
  addEventListener("dragleave", (event) => hasFiles(event) && over(-1));
  addEventListener("dragover", (event) => hasFiles(event) && event.preventDefault());
  addEventListener("drop", async (event) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    over(-depth);
    take(usable(await filesOf(event.dataTransfer)));
  });
}

/**
 * Listen for pasted images; an image without a file name gets one from the time.
 * @param {function(File[]): void} take
 */
export function listenToPastes(take) {
  document.addEventListener("paste", (event) => {
    const data = event.clipboardData;
    const files = usable(data?.files ?? []);
    const isText = takesText(event.target) && data?.types.includes("text/plain"); // some programs copy both
    if (!files.length || isText || document.querySelector("dialog[open]")) return;
    event.preventDefault();
    take(files.map((file) => (file.name === UNNAMED ? named(file) : file)));
  });
}

function named(file) {
  const moment = new Date(file.lastModified - new Date(file.lastModified).getTimezoneOffset() * 60_000);
  const name = `${t("pasted")} ${moment.toISOString().slice(0, 19).replaceAll(":", ".").replace("T", " ")}.png`;
  return new File([file], name, { type: file.type, lastModified: file.lastModified });
}

/** Leave out hidden files and files of file managers. @param {Iterable<File>} files */
export function usable(files) {
  return [...files].filter(({ name }) => !SYSTEM.test(name));
}

/** All files of a drop, including those in folders. The entries must be read before the first await. */
async function filesOf(transfer) {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  if (!entries.length) return [...transfer.files];
  const found = await Promise.all(entries.map(walk));
  return found.flat();
}

async function walk(entry) {
  if (entry.isFile) return [await new Promise((resolve, reject) => entry.file(resolve, reject))];
  const reader = entry.createReader();
  const found = [];
  for (;;) {
    const some = await new Promise((resolve, reject) => reader.readEntries(resolve, reject));
    if (!some.length) break; // a folder is listed in parts
    found.push(...some);
  }
  return (await Promise.all(found.map(walk))).flat();
}
