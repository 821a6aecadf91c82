/** The search, the sorting and the filters above the grid. */

import { byId, h } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";
import { debounce } from "../../shared/timing.js";
import { countTags } from "./tags.js";

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
    note: byId("filter-note", HTMLSelectElement),
    from: byId("filter-from", HTMLInputElement),
    to: byId("filter-to", HTMLInputElement),
  };
  sort.addEventListener("change", () => order.sortBy(/** @type {*} */ (sort.value)));
  search.addEventListener("input", debounce(() => order.filter({ text: search.value.trim() }), 150));
  for (const [name, field] of Object.entries(fields)) field.addEventListener("change", () => order.filter({ [name]: field.value }));
  const own = [...fields.note.options];
  byId("filter-menu").addEventListener("toggle", () => {
    const tags = countTags(store.photos.values());
    fields.note.replaceChildren(...own, ...[...tags].map(([tag, count]) => h("option", { value: `#${tag}` }, `#${tag} (${count})`)));
    fields.note.value = order.filters.note;
    if (!fields.note.value) order.filter({ note: "any" }); // no photo has this tag any more
  });
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
