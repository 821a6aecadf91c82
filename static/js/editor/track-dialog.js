/** The dialog to place photos by a GPX track: clock offset, time zone, and a preview. */

import { ACCEPTED } from "../shared/accepted.js";
import { errorLine, field, openDialog } from "../shared/dialogs.js";
import { h } from "../shared/dom.js";
import { labelled, t, tn } from "../shared/i18n.js";
import { debounce } from "../shared/timing.js";
import { nameList } from "./name-list.js";
import { offer, placeButton, placeOnClick } from "./place-button.js";

/**
 * Open the dialog.
 * @param {Object} page store, server, refresh and dots
 * @param {?File} given dropped on the page
 * @param {function(Object, string): void} report
 */
export function trackDialog({ server, refresh, dots, view }, given, report) {
  const file = h("input", { class: "input", type: "file", accept: ACCEPTED.tracks_of_photos });
  const offset = h("input", { class: "input", type: "number", step: "any", value: 0, inputmode: "decimal" });
  const zone = h("input", { class: "input", value: Intl.DateTimeFormat().resolvedOptions().timeZone || "UTC" });
  const gap = h("input", { class: "input", type: "number", min: 1, value: 60, inputmode: "numeric" });
  const outcome = h("div", { class: "stack stack--tight", "aria-live": "polite" });
  const error = errorLine();
  const place = placeButton();
  const dialog = openDialog(t("Place by a GPX track"), [
    h("p", { class: "soft" }, t("Each photo in the tray is placed where the track was when the photo was taken.")),
    given ? h("p", {}, given.name) : field(t("Track"), file),
    field(t("Seconds to add to the camera's time"), offset, t("Positive if the camera's clock was slow, negative if it was fast.")),
    field(t("Time zone of the camera"), zone),
    field(t("Longest gap to bridge, in seconds"), gap),
    outcome,
    error,
  ], { actions: [place], modeless: true });
  const fields = () => ({
    file: given || file.files[0], offset_s: offset.value || 0, time_zone: zone.value, max_gap_s: gap.value || 60,
  });

  let turn = 0;
  const look = async () => {
    const mine = (turn += 1);
    place.disabled = true;
    if (!fields().file) return;
    try {
      const seen = await server.matchTrack(fields(), { preview: true });
      if (mine !== turn) return;
      error.show(null);
      show(seen);
    } catch (problem) {
      if (mine === turn) error.show(problem);
    }
  };
  const show = (seen) => {
    const inside = seen.photos.filter(({ x_px: x }) => x !== null);
    dots.setMark(inside.map(({ x_px: x, y_px: y }) => [x, y]));
    if (inside.length) view.focus(inside.map(({ x_px: x, y_px: y }) => [x, y]));
    offer(place, inside.length);
    const outside = seen.photos.filter(({ problem }) => problem !== null);
    outcome.replaceChildren(...[
      h("p", {}, tn("{n} photo would be placed: see the rings on the image.", "{n} photos would be placed: see the rings on the image.", inside.length)),
      nameList(t("Outside the image"), outside.map(({ name, problem }) => labelled(name, problem))),
      nameList(t("Not found on the track"), seen.unmatched.map(({ name, reason }) => labelled(name, reason))),
      suggestion(seen.suggested),
    ].filter(Boolean));
  };
  const suggestion = (suggested) => {
    if (!suggested || Math.abs(suggested.offset_s - Number(offset.value)) < 1) return null;
    const seconds = Math.round(suggested.offset_s);
    const use = () => {
      offset.value = String(seconds);
      look();
    };
    return h("p", { class: "note" },
      h("span", {}, t("Photos with known positions fit best with {seconds} seconds.", { seconds })),
      h("button", { class: "button", type: "button", onclick: use }, t("Use it")));
  };
  const later = debounce(look, 400);
  for (const input of [file, offset, zone, gap]) input.addEventListener("input", later);
  placeOnClick(place, {
    place: () => server.matchTrack(fields(), { preview: false }),
    done: async (result) => {
      dialog.close();
      await refresh();
      report(result, t("Place by a GPX track"));
    },
    error,
  });
  dialog.addEventListener("close", () => {
    turn += 1;
    dots.setMark([]);
  });
  if (given) look();
}
