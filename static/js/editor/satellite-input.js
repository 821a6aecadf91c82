/** A map without an image: instructions, and an input for an image file. */

import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { toast, toastError } from "../shared/toast.js";

/**
 * Connect the empty state and the input.
 * @param {import("../shared/map/map-store.js").MapStore} store
 * @param {Object} server endpoints
 * @param {function(): Promise<void>} refresh
 */
export function satelliteInput(store, server, refresh) {
  const [empty, input, bar] = [byId("no-satellite"), byId("satellite-input", HTMLInputElement), byId("satellite-progress", HTMLProgressElement)];
  const render = () => {
    empty.hidden = Boolean(store.satellite);
    byId("editor").classList.toggle("has-image", Boolean(store.satellite));
  };
  input.addEventListener("change", async () => {
    const [file] = input.files;
    input.value = "";
    if (!file) return;
    bar.hidden = false;
    bar.removeAttribute("value");
    try {
      const onProgress = (sent, all) => (sent < all ? (bar.value = sent / all) : bar.removeAttribute("value"));
      await server.setSatellite(file, { onProgress });
      await refresh();
      toast(t("The image is in place."));
    } catch (error) {
      toastError(error);
    }
    bar.hidden = true;
  });
  store.on("satellite", render);
  render();
}
