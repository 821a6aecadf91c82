/** The chosen object: its photo, position and earlier sightings. */

import { byId, h, icon } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { copyablePlace } from "../shared/map/positions.js";
import { toastError } from "../shared/toast.js";
import { clockText, lengthText } from "./format.js";
import { stateBadge, stateButtons, stateName, stateText } from "./object-states.js";
import { metresBetween } from "./track-points.js";

/** @param {import("./mission-store.js").MissionStore} store */
export function showObject(store) {
  const card = byId("object");
  let note = noteField();
  let of = null;
  const render = (object, sightings) => {
    if (of !== object.key) [of, note] = [object.key, noteField()];
    const typing = document.activeElement === note;
    card.replaceChildren(...content(store, object, { sightings, note }));
    if (typing) note.focus();
  };
  card.addEventListener("keydown", (event) => event.key === "Escape" && store.choose(null));
  store.on("chosen", async () => {
    const object = store.objects.get(store.chosen);
    card.hidden = !object;
    if (!object) return;
    card.dataset.state = stamp(object);
    render(object, null);
    try {
      const received = await store.server(object.mission).object(object.id);
      if (store.chosen !== object.key) return;
      const sightings = received.sightings || [];
      store.setTrail(sightings);
      render({ ...object, ...received, key: object.key, mission: object.mission }, sightings);
    } catch (error) {
      toastError(error);
    }
  });
  store.on("objects", () => {
    const object = store.objects.get(store.chosen);
    if (store.chosen && !object) store.choose(null);
    else if (object && card.dataset.state !== stamp(object)) store.emit("chosen");
  });
}

/** Changes when the state is set. */
const stamp = ({ state, state_time_s: time }) => `${state} ${time}`;

/** The field for a note; reused when the card is rendered again, so that no text is lost. */
function noteField() {
  return h("input", { class: "input", type: "text", maxlength: 500, placeholder: t("Note"), "aria-label": t("Note"), autocomplete: "off" });
}

function content(store, object, { sightings, note }) {
  const photo = object.photo || sightings?.findLast(({ photo: one }) => one)?.photo || null;
  const facts = [
    [t("Class"), object.kind],
    [t("Position"), copyablePlace([object.lat, object.lon])],
    object.height_m !== null && object.height_m !== undefined && [t("Height"), lengthText(object.height_m)],
    object.confidence !== null && object.confidence !== undefined && [t("Confidence"), `${Math.round(object.confidence * 100)}\u00a0%`],
    object.size_m && [t("Size"), object.size_m.map(lengthText).join(" × ")],
    object.covariance && [t("Accuracy"), `± ${lengthText(sigmaOf(object.covariance))}`],
    [t("Seen"), seen(object)],
    sightings?.length > 1 && [t("Moved"), lengthText(moved(sightings))],
  ].filter(Boolean);
  const close = h("button", { class: "icon-button", type: "button", "aria-label": t("Close"), onclick: () => store.choose(null) }, icon("close"));
  return [
    h("div", { class: "mi-card__head" }, store.symbols.element(object.kind), h("h3", {}, object.id), stateBadge(object.state), close),
    photo && h("img", { class: "mi-card__photo", src: store.server(object.mission).photo(photo), alt: t("Photo of {name}", { name: object.id }) }),
    h("dl", { class: "facts small number" }, ...facts.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)])),
    ...task(store, object, note),
  ].filter(Boolean);
}

/** History of the object's state, and buttons to change it. */
function task(store, object, note) {
  const buttons = stateButtons(store, object, note);
  const changes = (object.changes || []).toReversed().map((change) =>
    h("li", {}, [stateName(change.state), stateText({ state_by: change.by, state_time_s: change.time_s }), change.note].filter(Boolean).join(" · ")));
  return [
    changes.length > 0 && h("ol", { class: "mi-changes small", "aria-label": t("History"), "data-testid": "object-changes" }, ...changes),
    buttons.length > 0 && note,
    buttons.length > 0 && h("div", { class: "mi-task__actions" }, ...buttons),
  ];
}

function seen({ first_time_s: first, last_time_s: last, count: times }) {
  const when = first === last ? clockText(last) : `${clockText(first)} – ${clockText(last)}`;
  return times > 1 ? `${tn("{n} time", "{n} times", times)}: ${when}` : when;
}

/** The largest standard deviation of a position over all directions. */
function sigmaOf([east, north, both]) {
  return Math.sqrt((east + north) / 2 + Math.hypot((east - north) / 2, both));
}

/** Distance between the first and the last position. */
function moved(sightings) {
  const [first, last] = [sightings[0], sightings.at(-1)];
  return metresBetween([first.lat, first.lon], [last.lat, last.lon]);
}
