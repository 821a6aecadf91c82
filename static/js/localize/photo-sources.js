/** Where photos come from: the file dialog, the phone's camera, a drop anywhere on the page, the clipboard. */

import { byId, takesText } from "../shared/dom.js";
import { listenToDrops, usable } from "../shared/drop-files.js";

/** @param {function(File[]): void} take */
export function listenToSources(take) {
  for (const input of [byId("query-input", HTMLInputElement), byId("shot-input", HTMLInputElement)]) {
    input.addEventListener("change", () => {
      const files = usable(input.files);
      input.value = "";
      take(files);
    });
  }
  listenToDrops(byId("drop"), take);
  addEventListener("paste", (event) => {
    const files = usable(event.clipboardData?.files || []);
    if (!files.length || (takesText(event.target) && event.clipboardData.types.includes("text/plain"))) return;
    event.preventDefault();
    take(files);
  });
}
