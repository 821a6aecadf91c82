/** The photo of a dot, with the details that the share includes. */

import { headingText } from "../shared/answer/answer-format.js";
import { byId, h } from "../shared/dom.js";
import { clockText } from "../shared/format.js";
import { t } from "../shared/i18n.js";
import { latLonText } from "../shared/map/coords.js";
import { creditLine } from "../shared/photo-credit.js";
import { WRITTEN } from "../shared/written-facts.js";

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
    byId("photo-facts").replaceChildren(...this._facts(photo).flatMap(([label, value]) => [h("dt", {}, label), h("dd", {}, value)]));
  }

  _facts(photo) {
    const place = [photo.x_px, photo.y_px];
    const latLon = this.store.georeference.latLon(place);
    return [
      [t("Placed at"), `x ${Math.round(place[0])}, y ${Math.round(place[1])}`],
      latLon && [t("Coordinates"), latLonText(latLon)],
      photo.heading_deg !== null && [t("Heading"), headingText(photo.heading_deg)],
      photo.taken_at && [t("Taken"), clockText(photo.taken_at)],
      ...WRITTEN.map(({ name, label }) => photo[name] && [label, h("span", { class: "note-text" }, photo[name])]),
      photo.source && [t("From"), creditLine(photo.source)],
      photo.original && [t("File"), h("a", { href: photo.original, download: true }, t("original"))],
    ].filter(Boolean);
  }
}
