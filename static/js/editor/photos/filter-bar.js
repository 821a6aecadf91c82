/** Search, sort order and filters above the grid. */

import { byId, h } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";
import { debounce } from "../../shared/timing.js";
import { WRITTEN } from "../../shared/written-facts.js";
import { countEach, tagsOf } from "./tags.js";

/** Debounce time: photos change in bursts, while they are uploaded or their details load. */
const OFFER_MS = 200;

/**
 * Connect the controls.
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
    ...Object.fromEntries(WRITTEN.map(({ name }) => [name, byId(`filter-${name}`, HTMLSelectElement)])),
    from: byId("filter-from", HTMLInputElement),
    to: byId("filter-to", HTMLInputElement),
  };
  sort.addEventListener("change", () => order.sortBy(/** @type {*} */ (sort.value)));
  search.addEventListener("input", debounce(() => order.filter({ text: search.value.trim() }), 150));
  for (const [name, field] of Object.entries(fields)) field.addEventListener("change", () => order.filter({ [name]: field.value }));
  const menu = byId("filter-menu", HTMLDetailsElement);
  let loading = false; // options may be missing while details of photos load
  const offer = () => {
    if (!menu.open) return;
    const photos = [...store.photos.values()];
    loading = [...store.photos.keys()].some((id) => !store.isKnown(id));
    byId("filter-loading").hidden = !loading;
    for (const { name, lines } of WRITTEN) {
      const words = photos.map((photo) => photo[name]);
      if (lines) offerBesides(name, countEach(words.flatMap(tagsOf)), "#");
      else offerBesides(name, countEach(words.filter(Boolean)), "=", "");
    }
    offerBesides("camera", countEach(photos.map(({ camera }) => camera).filter(Boolean)));
  };
  menu.addEventListener("toggle", offer);
  store.on("photos", debounce(offer, OFFER_MS));
  /** Offer the values found in the photos after the fixed options. @param {Map<string, number>} counts of each value */
  function offerBesides(name, counts, mark = "", shownMark = mark) {
    const field = fields[name];
    const always = [...field.options].filter((option) => !option.dataset.found);
    const chosen = order.filters[name];
    const found = [...counts].map(([value, count]) => choice(mark + value, `${shownMark}${value} (${count})`));
    const offered = [...always, ...found];
    const missing = !offered.some(({ value }) => value === chosen);
    if (missing && loading) offered.push(choice(chosen, chosen));
    if (!same(offered, [...field.options])) field.replaceChildren(...offered);
    field.value = chosen;
    if (missing && !loading) order.filter({ [name]: "any" }); // no photo has this value now
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

/** An option for a value found in photos. */
function choice(value, words) {
  return h("option", { value, "data-found": "yes" }, words);
}

/** Whether two lists of options have the same texts; an open list is not replaced needlessly. */
function same(offered, shown) {
  return offered.length === shown.length && offered.every(({ text }, n) => text === shown[n].text);
}
