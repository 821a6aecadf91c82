/** Photos of the mission, and where the map says that they were taken. */

import { h } from "../dom.js";
import { byId, whenCalm } from "../editor/page.js";
import { t } from "../i18n.js";
import { toastError } from "../toast.js";
import { clockText, lengthText, percentText } from "./words.js";

const CALM_MS = 800;

/**
 * Keep the list of photos right.
 * @param {import("./store.js").Store} store
 * @param {function({lat: number, lon: number}): void} look shows a place
 */
export function showPhotos(store, look) {
  const server = store.server(store.id);
  const load = async () => {
    try {
      const { photos } = await server.photos();
      store.setPhotos(store.id, photos);
      render(store, photos, look);
    } catch (error) {
      toastError(error);
    }
  };
  let seen = store.mission.photos;
  if (seen) load();
  const later = whenCalm(load, CALM_MS);
  store.on("missions grown", () => {
    if (store.mission.photos === seen && !fixesComing(store)) return;
    seen = store.mission.photos;
    later();
  });
}

function fixesComing(store) {
  return (store.photos.get(store.id) || []).some(({ fix_state: state }) => state === "queued");
}

function render(store, photos, look) {
  byId("photos-none").hidden = photos.length > 0;
  byId("tab-photos-count").textContent = photos.length || "";
  byId("photos").replaceChildren(...photos.map((photo) => row(store, photo, look)));
}

function row(store, photo, look) {
  const best = photo.fix?.hypotheses?.find(({ lat }) => Number.isFinite(lat));
  const text = h("span", { class: "lo-past__text" },
    h("span", { class: "lo-past__name" }, photo.name),
    photo.time_s !== null && photo.time_s !== undefined && h("span", { class: "small soft" }, clockText(photo.time_s)),
    h("span", { class: "small" }, outcome(photo, best)));
  const image = h("img", { class: "ed-thumb", src: photo.thumb || store.server(store.id).photo(photo.sha256), alt: "", loading: "lazy" });
  const show = () => {
    if (best) look(best);
    if (Number.isFinite(photo.time_s)) store.setMoment(Math.max(0, store.momentOf(store.mission, photo.time_s)));
  };
  return h("li", {}, h("button", { class: "lo-past mi-photo", type: "button", onclick: show }, image, text));
}

function outcome({ fix_state: state, fix }, best) {
  if (state === "queued") return t("is being localized");
  if (state === "failed") return t("could not be localized");
  if (!fix) return t("not localized");
  if (!best) return t("not from this map");
  const place = t("within {radius}, {probability}", { radius: lengthText(best.radius_m), probability: percentText(best.probability) });
  return fix.gated ? `${place} · ${t("left out of the fusion")}` : place;
}
