/** Search for places by name; the server asks a geocoder, if configured, and only on request. */

import { get } from "../shared/api.js";
import { h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";
import { page } from "./page.js";
import { eastOf } from "./tile-map.js";

const CLOSEST = 18;

/**
 * Make the search of a map.
 * @param {HTMLElement} list list of the places found, to choose one
 * @param {function(): ?L.Map} map
 * @returns {function(string): Promise<void>}
 */
export function placeSearch(list, map) {
  let newest = 0;
  return async (text) => {
    const turn = ++newest;
    const show = (...parts) => {
      if (turn !== newest) return;
      list.hidden = false;
      list.replaceChildren(...parts);
    };
    show(t("Searching ..."));
    try {
      const { places } = await get(`/places?q=${encodeURIComponent(text)}`);
      const credit = h("span", { class: "small soft" }, page.geocoder);
      if (!places.length) show(t("No place called {name} was found.", { name: text }), credit);
      else show(...places.map((place) => choice(place, map, list)), credit);
    } catch (error) {
      list.hidden = true;
      toastError(error);
    }
  };
}

function choice(place, map, list) {
  const go = () => {
    map()?.fitBounds([[place.south, place.west], [place.north, eastOf(place)]], { maxZoom: CLOSEST });
    list.hidden = true;
  };
  return h("button", { class: "button button--quiet", type: "button", onclick: go }, place.name);
}
