/** The object that was chosen: its photo, where it is, and where it was seen before. */

import { byId, h, icon } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { latLonText } from "../shared/map/coords.js";
import { toastError } from "../shared/toast.js";
import { clockText, lengthText } from "./format.js";
import { metresBetween } from "./track-points.js";

/** @param {import("./mission-store.js").MissionStore} store */
export function showObject(store) {
  const card = byId("object");
  card.addEventListener("keydown", (event) => event.key === "Escape" && store.choose(null));
  store.on("chosen", async () => {
    const object = store.objects.get(store.chosen);
    card.hidden = !object;
    if (!object) return;
    card.replaceChildren(...content(store, object, null));
    try {
      const received = await store.server(object.mission).object(object.id);
      if (store.chosen !== object.key) return;
      const sightings = received.sightings || [];
      store.setTrail(sightings);
      card.replaceChildren(...content(store, { ...object, ...received, key: object.key, mission: object.mission }, sightings));
    } catch (error) {
      toastError(error);
    }
  });
  store.on("objects", () => {
    if (store.chosen && !store.objects.has(store.chosen)) store.choose(null);
  });
}

function content(store, object, sightings) {
  const photo = object.photo || sightings?.findLast(({ photo: one }) => one)?.photo || null;
  const facts = [
    [t("Class"), object.kind],
    [t("Position"), latLonText([object.lat, object.lon])],
    object.height_m !== null && object.height_m !== undefined && [t("Height"), lengthText(object.height_m)],
    object.confidence !== null && object.confidence !== undefined && [t("Confidence"), `${Math.round(object.confidence * 100)}\u00a0%`],
    [t("Seen"), seen(object)],
    sightings?.length > 1 && [t("Moved"), lengthText(moved(sightings))],
  ].filter(Boolean);
  const close = h("button", { class: "icon-button", type: "button", "aria-label": t("Close"), onclick: () => store.choose(null) }, icon("close"));
  return [
    h("div", { class: "mi-card__head" }, store.symbols.element(object.kind), h("h3", {}, object.id), close),
    photo && h("img", { class: "mi-card__photo", src: store.server(object.mission).photo(photo), alt: t("Photo of {name}", { name: object.id }) }),
    h("dl", { class: "facts small number" }, ...facts.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)])),
  ].filter(Boolean);
}

function seen({ first_time_s: first, last_time_s: last, count: times }) {
  const when = first === last ? clockText(last) : `${clockText(first)} – ${clockText(last)}`;
  return times > 1 ? `${tn("{n} time", "{n} times", times)}: ${when}` : when;
}

/** How far apart the first and the last position are. */
function moved(sightings) {
  const [first, last] = [sightings[0], sightings.at(-1)];
  return metresBetween([first.lat, first.lon], [last.lat, last.lon]);
}
