/** Sources of photos: file dialog, phone camera, drop anywhere on the page, clipboard, examples of the map. */

import { busy } from "../shared/dialogs.js";
import { byId, queryAll, takesText } from "../shared/dom.js";
import { listenToDrops, usable } from "../shared/drop-files.js";
import { toastError } from "../shared/toast.js";

/**
 * @param {function(File[]): void} take
 * @param {function(string): Promise<Blob>} example fetches an example photo of the map by name
 */
export function listenToSources(take, example) {
  for (const button of queryAll("[data-example]", HTMLButtonElement)) {
    const name = button.dataset.example;
    button.addEventListener("click", () => {
      const chosen = example(name).then((photo) => take([new File([photo], name, { type: photo.type })]));
      busy(button, () => chosen).catch(toastError);
    });
    button.disabled = false; // disabled until this listener is attached
  }
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
