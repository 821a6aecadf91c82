/** Photos of the mission and their localization on its map. */

import { busy } from "../shared/dialogs.js";
import { byId, h, icon } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { debounce } from "../shared/timing.js";
import { toastError } from "../shared/toast.js";
import { radiusOf } from "./fixes.js";
import { clockText, lengthText } from "./format.js";
import { ended } from "./job-progress.js";

const CALM_MS = 800;

/**
 * Keep the list of photos up to date.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {function({lat: number, lon: number}): void} look shows a position
 */
export function showPhotos(store, look) {
  const server = store.server(store.id);
  const load = async () => {
    try {
      const { photos } = await server.photos();
      shown = photos;
      render(store, photos, look);
    } catch (error) {
      toastError(error);
    }
  };
  let shown = [];
  let seen = store.mission.photos;
  if (seen) load();
  store.on("photos", load);
  const later = debounce(load, CALM_MS);
  store.on("missions grown", () => {
    if (store.mission.photos === seen && !shown.some(({ fix_state: state }) => state === "queued")) return;
    seen = store.mission.photos;
    later();
  });
}

function render(store, photos, look) {
  byId("photos-none").hidden = photos.length > 0;
  byId("tab-photos-count").textContent = photos.length || "";
  byId("photos").replaceChildren(...photos.map((photo, n) => row(store, named(photo, n), look)));
}

/** A photo with replacements for file name and EXIF time, which visitors do not get. */
function named(photo, n) {
  return { ...photo, name: photo.name ?? t("Photo {id}", { id: n + 1 }), time_s: photo.time_s ?? photo.fix?.time ?? null };
}

function row(store, photo, look) {
  const { fix, sha256, name, time_s: time } = photo;
  const found = fix && fix.lat !== null && fix.lat !== undefined;
  const text = h("span", { class: "lo-past__text" },
    h("span", { class: "lo-past__name" }, name),
    time !== null && h("span", { class: "small soft" }, clockText(time)),
    h("span", { class: "small" }, outcome(photo, found)));
  const image = h("img", { class: "ed-thumb", src: photo.thumb || store.server(store.id).photo(sha256), alt: "", loading: "lazy" });
  const show = () => {
    if (found) look(fix);
    if (time !== null && store.clock) store.setMoment(Math.max(0, store.momentOf(store.mission, time)));
  };
  const ask = canAsk(store, photo) && h("button", {
    class: "icon-button", type: "button", title: t("Localize on the map"), "aria-label": t("Localize {name} on the map", { name }),
    onclick: (event) => busy(event.currentTarget, () => localize(store, photo)),
  }, icon("target"));
  return h("li", { class: "mi-photo" }, h("button", { class: "lo-past", type: "button", onclick: show }, image, text), ask);
}

/** Whether a photo can be localized: on a mission with a map, and only once. */
function canAsk({ mission }, { fix, fix_state: state }) {
  return mission.can_edit && mission.map && !fix && state !== "queued";
}

async function localize(store, { sha256 }) {
  const server = store.server(store.id);
  try {
    const { job } = await server.localize(sha256);
    await ended(server.job, job, () => {});
  } catch (error) {
    toastError(error);
  }
  store.emit("photos");
}

function outcome({ fix_state: state, fix }, found) {
  if (state === "queued") return t("is being localized");
  if (state === "failed") return t("could not be localized");
  if (!fix) return t("not localized");
  if (!found) return t("not from this map");
  const [[east], [, north]] = fix.position_covariance_m2;
  const place = t("found, within {radius}", { radius: lengthText(Number(radiusOf(east, north).toPrecision(2))) });
  return fix.gated ? `${place} · ${t("left out of the fusion")}` : place;
}
