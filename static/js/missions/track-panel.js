/** The list of tracks: visibility, length, and distance between start and end. */

import { byId, h, icon } from "../shared/dom.js";
import { locale, t, tn } from "../shared/i18n.js";
import { copyablePlace } from "../shared/map/positions.js";
import { rafThrottle } from "../shared/timing.js";
import { nthColour, trackColour } from "./colour-scales.js";
import { ellipseOf } from "./draw-marks.js";
import { clockText, lengthText, percentText, SHORTEST_S, spanText, speedText, trackName, usualName } from "./format.js";
import { lookButton } from "./track-look.js";

/**
 * Keep the list up to date.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {{fit: function(Object): void, forget: function(number): void}} page
 */
export function showTracks(store, page) {
  const box = byId("tracks");
  const render = () => {
    const focused = document.activeElement?.id;
    box.replaceChildren(...[...store.missions.values()].map((mission, n) => section(store, page, { mission, n })));
    if (focused && box.querySelector(`#${CSS.escape(focused)}`)) byId(focused).focus();
  };
  store.on("missions shown mode", render);
  store.on("grown", rafThrottle(() => numbers(store, box)));
  render();
}

function section(store, page, { mission, n }) {
  const several = store.missions.size > 1;
  const tracks = store.tracks.filter((one) => one.mission === mission);
  const head = several && h("div", { class: "mi-mission__head" },
    swatch(nthColour(n)),
    h("h3", {}, mission.id === store.id ? mission.name : h("a", { href: `/missions/${mission.id}` }, mission.name)),
    mission.id !== store.id && h("button", {
      class: "icon-button", type: "button", title: t("Remove it"), "aria-label": t("Remove {name}", { name: mission.name }),
      onclick: () => page.forget(mission.id),
    }, icon("close")));
  const none = !tracks.length && h("p", { class: "soft small mi-none" }, t("No positions yet."));
  return h("section", { class: "mi-mission" }, head, none, h("ul", { class: "mi-tracks" }, ...tracks.map((one) => row(store, page, one))));
}

function row(store, page, { mission, track, key }) {
  const id = `track-${key.replace("/", "-")}`;
  const name = trackName(track);
  const box = h("input", { type: "checkbox", id, checked: store.isShown({ track, key }), onchange: (event) => store.setShown(key, event.target.checked) });
  const colour = trackColour(store, { mission, track });
  return h("li", { class: "mi-track", "data-testid": "track", dataset: { key } },
    h("div", { class: "mi-track__head" },
      h("label", { class: "check" }, box, swatch(colour), h("span", { class: "mi-track__name" }, name)),
      mission.can_edit && lookButton(store, { mission, track, key }, { class: "icon-button", id: `${id}-look` }, icon("pencil")),
      h("button", {
        class: "icon-button", type: "button", title: t("Zoom to it"), "aria-label": t("Zoom to {name}", { name }),
        disabled: !track.bounds, onclick: () => page.fit(track),
      }, icon("fit"))),
    h("dl", { class: "facts small number mi-track__facts", "data-part": "facts" }, ...facts(track)));
}

/** Update only the numbers, for new data. */
function numbers(store, box) {
  for (const { track, key } of store.tracks) {
    const part = box.querySelector(`[data-key="${CSS.escape(key)}"] [data-part="facts"]`);
    const focused = part?.contains(document.activeElement);
    part?.replaceChildren(...facts(track));
    if (focused) part.querySelector("button")?.focus();
  }
}

function facts(track) {
  const { poses, skipped, removed, thinned_m: error, distance_m: way, duration_s: duration, closing } = track;
  /** @type {Array<[string, string|HTMLElement]>} */
  const rows = [[t("Distance"), lengthText(way || 0)]];
  if (track.look?.title) rows.unshift([t("Track"), usualName(track)]);
  if (duration >= SHORTEST_S) {
    const speed = t("{speed} on average", { speed: speedText(way / duration) });
    rows.push([t("Duration"), `${spanText(duration)} (${speed})`]);
  }
  const left = skipped ? `, ${tn("{n} left out, as it had hardly moved", "{n} left out, as it had hardly moved", skipped)}` : "";
  rows.push([t("Positions"), poses.toLocaleString(locale) + left]);
  if (removed) {
    const how = error === null ? t("only both ends are left") : t("to {error}", { error: lengthText(error) });
    rows.push([t("Thinned"), `${tn("{n} position removed", "{n} positions removed", removed)}, ${how}`]);
  }
  if (track.first_time_s !== null && track.first_time_s !== undefined) rows.push([t("Begin"), clockText(track.first_time_s)]);
  if (!track.timed) rows.push([t("Times"), t("unknown: only the order of the points is known")]);
  if (track.last) rows.push([t("Last position"), copyablePlace([track.last.lat, track.last.lon])]);
  if (track.last?.covariance_m2) rows.push([t("Accuracy"), withinText(track.last.covariance_m2)]);
  if (closing) rows.push([t("End to start"), t("{gap}, {share} of the distance", { gap: lengthText(closing.gap_m), share: percentText(closing.share) })]);
  return rows.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]);
}

/** Half axes of the ellipse on the map. @param {number[]} covariance */
function withinText(covariance) {
  const axes = new Set(Object.values(ellipseOf(covariance)).slice(0, 2).map(lengthText));
  return `± ${[...axes].join(" × ")} (68\u00a0%)`;
}

function swatch(colour) {
  const made = h("span", { class: "mi-swatch", "aria-hidden": "true" });
  made.style.background = colour;
  return made;
}
