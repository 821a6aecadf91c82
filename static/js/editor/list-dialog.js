/** The dialog for a list of positions: choice of columns, and a preview of the placing. */

import { ACCEPTED } from "../shared/accepted.js";
import { columnChoice } from "../shared/column-choice.js";
import { errorLine, field, openDialog } from "../shared/dialogs.js";
import { h } from "../shared/dom.js";
import { metresText } from "../shared/format.js";
import { labelled, t, tn } from "../shared/i18n.js";
import { debounce } from "../shared/timing.js";
import { nameList } from "./name-list.js";
import { offer, placeButton, placeOnClick } from "./place-button.js";

/** @type {import("../shared/column-choice.js").Field[]} */
const PHOTO_COLUMNS = [
  { name: "name", label: () => t("File name"), units: [], usual: /^(photo_?)?(name|file_?name)$|^(photo|file|source_?file|path|image(_name)?|img|picture|title)$/i, needed: true },
  { name: "lat", label: () => t("Latitude"), units: ["deg", "rad", "e7"], usual: /^(gps_?)?lat(itude)?(_deg)?$/i },
  { name: "lon", label: () => t("Longitude"), units: ["deg", "rad", "e7"], usual: /^(gps_?)?(lon|lng|long|longitude)(_deg)?$/i },
  { name: "x", label: () => t("x, pixels"), units: [], usual: /^(x(_px)?|px|pixel_x|column)$/i },
  { name: "y", label: () => t("y, pixels"), units: [], usual: /^(y(_px)?|py|pixel_y|row)$/i },
  { name: "heading", label: () => t("Heading"), units: ["deg", "rad"], usual: /^(heading|course|bearing|hdg|azimuth|yaw|direction|gpsimgdirection)(_deg)?$/i },
];

/**
 * Open the dialog.
 * @param {Object} page server, refresh, dots and view
 * @param {?File} given dropped on the page
 * @param {function(Object, string): void} report
 */
export function listDialog({ server, refresh, dots, view }, given, report) {
  const file = h("input", { class: "input", type: "file", accept: ACCEPTED.positions, "data-testid": "list-file" });
  const columns = columnChoice(PHOTO_COLUMNS, ({ name }, text) => !/\.cfg$/i.test(name) && !/^\ufeff?\s*([{<]|SQLite format 3)/.test(text));
  const movePlaced = h("input", { type: "checkbox", "data-testid": "list-move" });
  const moveLine = h("label", { class: "row", hidden: true }, movePlaced, t("Also move placed photos"));
  const outcome = h("div", { class: "stack stack--tight", "aria-live": "polite", "data-testid": "list-outcome" });
  const error = errorLine();
  const place = placeButton({ "data-testid": "list-place" });
  const about = t("A .cfg; a table with file names and latitude and longitude, or pixels; GeoJSON, KML, GeoPackage, or GPX with waypoints named like the photos.");
  const dialog = openDialog(t("Place by a list of positions"), [
    given ? h("p", {}, given.name) : field(t("List"), file, about), outcome, moveLine, error, columns.element,
  ], { actions: [place], modeless: true });
  const fields = () => ({ file: given || file.files[0], columns: columns.value(), move_placed: movePlaced.checked });

  let seen = null;
  let turn = 0;
  const show = () => {
    const inside = seen.photos.filter(({ problem }) => problem === null);
    const fresh = inside.filter(({ from_px: before }) => before === null);
    const moves = inside.filter((photo) => photo.moves);
    const wanted = movePlaced.checked ? [...fresh, ...moves] : fresh;
    dots.setMark(wanted.map(({ x_px: x, y_px: y }) => [x, y]));
    moveLine.hidden = !moves.length;
    offer(place, wanted.length);
    const outside = seen.photos.filter(({ problem }) => problem !== null);
    const there = inside.length - fresh.length - moves.length;
    outcome.replaceChildren(...[
      !fresh.length && !moves.length && h("p", {}, t("Nothing to place.")),
      fresh.length > 0 && h("p", {}, tn("{n} tray photo will be placed: see the rings on the image.", "{n} tray photos will be placed: see the rings on the image.", fresh.length)),
      nameList(t("Elsewhere now"), farthest(moves)),
      there > 0 && h("p", { class: "soft" }, tn("{n} photo is there already.", "{n} photos are there already.", there)),
      nameList(t("Outside the image"), outside.map(({ name, problem }) => labelled(name, problem))),
      nameList(t("Listed, but no photo has this name"), seen.unknown),
      nameList(t("Ambiguous name"), seen.ambiguous),
      seen.missing > 0 && h("p", { class: "soft" }, tn("{n} photo in the tray is not in the list.", "{n} photos in the tray are not in the list.", seen.missing)),
    ].filter(Boolean));
    return wanted;
  };
  const look = async () => {
    const mine = (turn += 1);
    place.disabled = true;
    if (!fields().file) return;
    const ask = h("p", {}, t("Say which columns hold the file name and the position."));
    if (!columns.complete() && columns.value()) {
      outcome.replaceChildren(ask);
      return;
    }
    try {
      const answer = await server.placeByList(fields(), { preview: true });
      if (mine !== turn) return;
      error.show(null);
      seen = answer;
      // If all listed photos are placed, the list can only be meant to move them.
      movePlaced.checked = seen.photos.every(({ from_px: before }) => before !== null);
      const wanted = show();
      if (wanted.length) view.focus(wanted.map(({ x_px: x, y_px: y }) => [x, y]));
    } catch (problem) {
      if (mine !== turn) return;
      outcome.replaceChildren(...(columns.complete() ? [] : [ask])); // the server knows more headers
      moveLine.hidden = true;
      error.show(problem);
    }
  };
  const take = async () => {
    await columns.look(fields().file);
    await look();
  };
  file.addEventListener("change", take);
  columns.element.addEventListener("change", debounce(look, 200));
  movePlaced.addEventListener("change", show);
  placeOnClick(place, {
    place: () => server.placeByList(fields(), { preview: false }),
    done: async (result) => {
      dialog.close();
      await refresh();
      report(result, t("Place by a list of positions"));
    },
    error,
  });
  dialog.addEventListener("close", () => {
    turn += 1;
    dots.setMark([]);
  });
  if (given) take();
}

/** How far photos move, the farthest first. */
function farthest(moves) {
  const sorted = [...moves].sort((a, b) => b.moved_px - a.moved_px);
  const far = ({ moved_px: px, moved_m: m }) => (m === null ? t("{n} pixels", { n: Math.round(px) }) : metresText(m));
  return sorted.map((photo) => labelled(photo.name, far(photo)));
}
