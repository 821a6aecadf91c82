/** Zoom buttons on a Leaflet map, instead of Leaflet's own. */

import { h, icon } from "../dom.js";
import { t } from "../i18n.js";

/**
 * Add the buttons in the corner.
 * @param {L.Map} map made with `zoomControl: false`
 * @param {?function(): void} [whole] shows the whole image, for a map of limited extent
 */
export function addZoomButtons(map, whole = null) {
  const button = (name, label, onclick) => h("button", { class: "icon-button", type: "button", "aria-label": label, onclick }, icon(name));
  const buttons = h("div", { class: "ed-zoom", role: "group", "aria-label": t("Zoom of the image") },
    button("plus", t("Zoom in"), () => map.zoomIn()),
    button("minus", t("Zoom out"), () => map.zoomOut()),
    whole && button("fit", t("Show the whole image"), whole));
  L.DomEvent.disableClickPropagation(buttons); // a press on them is no click on the map
  const control = new L.Control({ position: "topright" });
  control.onAdd = () => buttons;
  control.addTo(map);
}
