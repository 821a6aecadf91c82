/** Choice of the background: the image of the mission's map or of another, a plain plane, or tiles if chosen. */

import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";
import { ImageGround, PlainGround, TileGround } from "./background.js";
import { mapImage } from "./endpoints.js";

const KEPT = "expmap-mission-ground";
const OF_MAP = "map:";

/**
 * Choose a ground, and let people change it. Tiles of other hosts are fetched only after they were chosen.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {import("./mission-view.js").MissionView} view
 * @param {{services: Array<Object>, maps: Array<{slug: string, name: string}>, fit: function(): void}} page
 */
export function chooseGround(store, view, { services, maps, fit }) {
  const select = byId("ground", HTMLSelectElement);
  const offered = () => [
    ...(isOnImage(store.mission) ? [["image", t("Image of the map")]] : []),
    ...maps.map(({ slug, name }) => [OF_MAP + slug, t("Image of {name}", { name })]),
    ["plain", t("Plain, in metres")],
    ...services.map(({ name, url }) => [name, t("{name} (fetched from {host})", { name, host: hostOf(url) })]),
  ];
  const make = (name) => {
    if (name === "image") return new ImageGround(store.mission.satellite);
    const service = services.find((one) => one.name === name);
    return service ? new TileGround(service) : new PlainGround(placeOf(store));
  };
  let made = "";
  const put = (ground, done) => {
    view.setGround(ground);
    done?.();
  };
  const show = (name, done = null) => {
    const before = made;
    made = select.value = name;
    offer(name === "plain" && remembered() !== "plain" ? services[0] : null, () => choose(services[0].name));
    if (!name.startsWith(OF_MAP)) return put(make(name), done);
    return mapImage(name.slice(OF_MAP.length))
      .then((satellite) => made === name && put(new ImageGround(satellite), done)) // unless another one was chosen meanwhile
      .catch((error) => {
        toastError(error);
        if (made !== name) return;
        if (view.ground) made = select.value = before;
        else show("plain", done); // fallback: some ground is needed
      });
  };
  const choose = (name) => {
    remember(name.startsWith(OF_MAP) ? "image" : name);
    show(name);
  };
  const settle = () => {
    const choices = offered();
    select.replaceChildren(...choices.map(([name, label]) => new Option(label, name)));
    select.closest("[data-part]").toggleAttribute("hidden", choices.length < 2);
    const kept = remembered();
    const name = made || (choices.some(([one]) => one === kept) && kept !== "image" ? kept : choices[0][0]);
    select.value = name;
    const isImage = name === "image" || name.startsWith(OF_MAP);
    if (made || (!isImage && !placeOf(store))) return;
    show(name, fit);
  };
  select.addEventListener("change", () => choose(select.value));
  store.on("missions grown", settle);
  settle();
}

/** Offer tiles on the plain ground, naming their host. */
function offer(service, take) {
  const box = document.getElementById("ground-offer");
  if (!box) return; // pages for visitors lack it
  box.hidden = !service;
  if (!service) return;
  byId("ground-offer-text").textContent = t("No map shows this place. A background map would be fetched from {host}.", { host: hostOf(service.url) });
  byId("ground-offer-yes").onclick = take;
  byId("ground-offer-no").onclick = () => {
    remember("plain");
    box.hidden = true;
  };
}

/** Host of a tile address, which contains braces. @param {string} url */
function hostOf(url) {
  return new URL(url.replaceAll(/[{}]/g, ""), location.href).host;
}

/** The stored choice. In another site's frame, browsers may refuse storage with an error. */
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

/** Whether the mission's map has a georeferenced image that overlaps a track. */
function isOnImage(mission) {
  const places = mission?.satellite?.georeference?.latlon_grid?.latlon.filter(Boolean);
  if (!places?.length) return false;
  const known = mission.tracks.map(({ bounds }) => bounds).filter(Boolean);
  const [lats, lons] = [places.map(([lat]) => lat), places.map(([, lon]) => lon)];
  const meets = ([south, west, north, east]) =>
    south <= Math.max(...lats) && north >= Math.min(...lats) && west <= Math.max(...lons) && east >= Math.min(...lons);
  return !known.length || known.some(meets);
}

/** Some position of the mission's data. @returns {?[number, number]} */
function placeOf(store) {
  const { mission } = store;
  const bounds = store.tracks.find(({ track }) => track.bounds)?.track.bounds;
  if (bounds) return [(bounds[0] + bounds[2]) / 2, (bounds[1] + bounds[3]) / 2];
  const object = store.objects.values().next().value;
  return object ? [object.lat, object.lon] : mission?.start ? [mission.start.lat, mission.start.lon] : store.drawn;
}
