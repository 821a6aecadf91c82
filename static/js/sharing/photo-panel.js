/** The photo of a dot, with the details that the share includes. */

import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { factElements, photoFacts } from "../shared/photo-facts.js";

/** Follows the current photo of the store. */
export class PhotoPanel {
  /**
   * @param {import("../shared/map/map-store.js").MapStore} store
   * @param {import("../shared/map/map-view.js").MapView} view
   */
  constructor(store, view) {
    this.store = store;
    this.view = view;
    byId("photo-previous").addEventListener("click", () => this._step(-1));
    byId("photo-next").addEventListener("click", () => this._step(1));
    store.on("current photos", () => this._show());
    store.on("current", () => store.current && view.reveal([store.current.x_px, store.current.y_px]));
  }

  _step(by) {
    const { order, currentId } = this.store;
    const next = (order.indexOf(currentId) + by + order.length) % order.length;
    this.store.setCurrent(order[next]);
  }

  _show() {
    const photo = this.store.current;
    byId("photo").hidden = !photo;
    if (!photo) return;
    const image = byId("photo-image", HTMLImageElement);
    image.parentElement.hidden = !photo.preview;
    if (photo.preview) image.src = photo.preview;
    const name = photo.name || t("Photo {id}", { id: photo.id });
    image.alt = name;
    byId("photo-name").textContent = name;
    byId("photo-facts").replaceChildren(...factElements(photoFacts(this.store, photo)));
  }
}
