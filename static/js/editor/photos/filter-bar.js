/** The search, the sorting and the filters above the grid. */

import { byId, h } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";
import { debounce } from "../../shared/timing.js";
import { countEach, countTags } from "./tags.js";

/**
 * Connect them.
 * @param {import("./photo-order.js").PhotoOrder} order
 * @param {import("../../shared/map/map-store.js").MapStore} store
 */
export function connectFilters(order, store) {
  const sort = byId("photo-sort", HTMLSelectElement);
  const search = byId("tray-search", HTMLInputElement);
  const fields = {
    gps: byId("filter-gps", HTMLSelectElement),
    heading: byId("filter-heading", HTMLSelectElement),
    accuracy: byId("filter-accuracy", HTMLSelectElement),
    camera: byId("filter-camera", HTMLSelectElement),
    note: byId("filter-note", HTMLSelectElement),
    from: byId("filter-from", HTMLInputElement),
    to: byId("filter-to", HTMLInputElement),
  };
  sort.addEventListener("change", () => order.sortBy(/** @type {*} */ (sort.value)));
  search.addEventListener("input", debounce(() => order.filter({ text: search.value.trim() }), 150));
  for (const [name, field] of Object.entries(fields)) field.addEventListener("change", () => order.filter({ [name]: field.value }));
  byId("filter-menu").addEventListener("toggle", () => {
    const photos = [...store.photos.values()];
    offerBesides("note", [...countTags(photos)].map(([tag, count]) => [`#${tag}`, count]));
    offerBesides("camera", [...countEach(photos.map(({ camera }) => camera).filter(Boolean))]);
  });
  /** Values that photos have, after the choices that there always are. */
  function offerBesides(name, values) {
    const field = fields[name];
    const always = [...field.options].filter((option) => !option.dataset.found);
    field.replaceChildren(...always, ...values.map(([value, count]) => h("option", { value, "data-found": "yes" }, `${value} (${count})`)));
    field.value = order.filters[name];
    if (!field.value) order.filter({ [name]: "any" }); // no photo has it any more
  }
  byId("filter-clear").addEventListener("click", () => order.clear());
  const render = () => {
    for (const [name, field] of Object.entries(fields)) field.value = order.filters[name];
    sort.value = order.sort;
    sort.title = order.sort === "distance" ? t("Distance from {name}", { name: store.photos.get(order.reference)?.name ?? "–" }) : "";
    const count = byId("filter-count");
    count.hidden = !order.active;
    count.textContent = String(order.active);
    byId("filter-clear", HTMLButtonElement).disabled = !order.active;
  };
  order.addEventListener("change", render);
  render();
}
