/** Which ground the mission lies on: the image of its map, else a plain plane; tiles where somebody chooses them. */

import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { ImageGround, PlainGround, TileGround } from "./background.js";

const KEPT = "expmap-mission-ground";

/**
 * Choose the ground, and let people choose another one.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {import("./mission-view.js").MissionView} view
 * @param {{services: Array<Object>, fit: function(): void}} page
 */
export function chooseGround(store, view, { services, fit }) {
  const select = byId("ground", HTMLSelectElement);
  const offered = () => [
    ...(isOnImage(store.mission) ? [["image", t("Image of the map")]] : []),
    ["plain", t("Plain, in metres")],
    ...services.map(({ name }) => [name, name]),
  ];
  const make = (name) => {
    if (name === "image") return new ImageGround(store.mission.satellite);
    const service = services.find((one) => one.name === name);
    return service ? new TileGround(service) : new PlainGround(placeOf(store));
  };
  let made = "";
  const settle = () => {
    const choices = offered();
    select.replaceChildren(...choices.map(([name, label]) => new Option(label, name)));
    select.closest("[data-part]").toggleAttribute("hidden", choices.length < 2);
    const kept = remembered();
    const name = made || (choices.some(([one]) => one === kept) && kept !== "image" ? kept : choices[0][0]);
    select.value = name;
    if (made || (name !== "image" && !placeOf(store))) return;
    made = name;
    view.setGround(make(name));
    fit();
  };
  select.addEventListener("change", () => {
    made = select.value;
    remember(made);
    view.setGround(make(made));
  });
  store.on("missions grown", settle);
  settle();
}

/** Browsers keep nothing for a page in another site's frame, and say so with an error. */
function remembered() {
  try {
    return localStorage.getItem(KEPT);
  } catch (error) {
    if (error.name !== "SecurityError") throw error;
    return null;
  }
}

function remember(name) {
  try {
    localStorage.setItem(KEPT, name);
  } catch (error) {
    if (error.name !== "SecurityError") throw error;
  }
}

/** Whether the mission's map has an image that knows where it is, and what there is to see begins on it. */
function isOnImage(mission) {
  const places = mission?.satellite?.georeference?.latlon_grid?.latlon.filter(Boolean);
  if (!places?.length) return false;
  const known = mission.tracks.map(({ bounds }) => bounds).filter(Boolean);
  const [lats, lons] = [places.map(([lat]) => lat), places.map(([, lon]) => lon)];
  const meets = ([south, west, north, east]) =>
    south <= Math.max(...lats) && north >= Math.min(...lats) && west <= Math.max(...lons) && east >= Math.min(...lons);
  return !known.length || known.some(meets);
}

/** Any place of what there is to see. @returns {?[number, number]} */
function placeOf(store) {
  const { mission } = store;
  const bounds = store.tracks.find(({ track }) => track.bounds)?.track.bounds;
  if (bounds) return [(bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2];
  const object = store.objects.values().next().value;
  return object ? [object.lat, object.lon] : mission?.start ? [mission.start.lat, mission.start.lon] : null;
}
