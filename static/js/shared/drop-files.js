/** Files that are dropped or chosen: folders are walked, and what belongs to the system is left out. */

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

/** Leave out what file managers leave behind. @param {Iterable<File>} files */
export function usable(files) {
  return [...files].filter(({ name }) => !SYSTEM.test(name));
}

/** All files of a drop, those inside folders too. The entries have to be taken before the first wait. */
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
