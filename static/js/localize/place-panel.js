/** The selected place: coordinates to copy, and buttons to add the photo to the map. */

import { placeName } from "../shared/answer/answer-list.js";
import { copyButton } from "../shared/clipboard.js";
import { busy } from "../shared/dialogs.js";
import { byId, h, icon } from "../shared/dom.js";
import { lengthText, numberText } from "../shared/format.js";
import { t } from "../shared/i18n.js";
import { onPositionForm, positionForm } from "../shared/map/positions.js";
import { term } from "../shared/term.js";
import { debounce } from "../shared/timing.js";
import { toast, toastError } from "../shared/toast.js";

const CALM_MS = 60;

/** @param {{session: import("../shared/answer/query-session.js").QuerySession, server: Object, canEdit: boolean, slug: string}} page */
export function showPlace(page) {
  const { session } = page;
  const coordinates = debounce(() => showCoordinates(page), CALM_MS);
  const render = () => {
    const { position } = session;
    const buttons = actions(page);
    byId("place").hidden = !position && !buttons.length;
    byId("place-title").textContent = title(session);
    byId("adopt-actions").replaceChildren(...buttons);
    if (position) coordinates();
    else byId("coordinates").replaceChildren();
  };
  session.on("chosen spot query mode", render);
  onPositionForm(render);
}

function title({ spot, hypothesis }) {
  if (spot) return t("Position set by you");
  return hypothesis ? placeName(hypothesis) : t("Do you know where it was taken?");
}

/** @type {?AbortController} of the pending request */
let asked = null;

async function showCoordinates({ session, server }) {
  asked?.abort();
  const abort = new AbortController();
  asked = abort;
  const { position } = session;
  if (!position) return;
  const pixels = row([t("Map")], `${numberText(position[0], 1)}, ${numberText(position[1], 1)} px`);
  try {
    const received = await server.coordinates(position, abort.signal);
    if (abort.signal.aborted) return;
    const known = [
      ["degrees", [t("Decimal")], received.decimal],
      ["dms", [t("Degrees")], received.dms],
      ["utm", ["UTM", " ", term("utm")], received.utm],
      ["mgrs", ["MGRS", " ", term("mgrs")], received.mgrs],
    ];
    const first = (form) => Number(form !== positionForm());
    const rows = known.filter(([, , text]) => text).sort(([a], [b]) => first(a) - first(b)).flatMap(([, name, text]) => row(name, text));
    byId("coordinates").replaceChildren(...(rows.length ? rows : pixels), ...poseRows(session));
  } catch (error) {
    if (error.name !== "AbortError") byId("coordinates").replaceChildren(...pixels, ...poseRows(session));
  }
}

/** Camera pose with standard deviations, if it was computed from landmarks. */
function poseRows({ spot, hypothesis }) {
  const camera = spot ? null : hypothesis?.camera;
  if (!camera) return [];
  const sigma = (axis) => Math.sqrt(camera.covariance[axis][axis]);
  const metres = hypothesis.radius_m === null ? null : hypothesis.radius_m / hypothesis.radius_px;
  const angle = (degrees, axis) => `${numberText(degrees, 1)}° ± ${numberText(sigma(axis), 1)}°`;
  const height = `${lengthText(camera.height_m, camera.height_px)} ± ${lengthText(metres && metres * sigma(2), sigma(2))}`;
  const facts = [
    [t("Height"), t("{height}, over the nearest placed camera", { height })],
    [t("Heading"), angle(hypothesis.heading_deg, 3)],
    [t("Pitch"), angle(camera.pitch_deg, 4)],
    [t("Roll"), angle(camera.roll_deg, 5)],
    [t("Landmarks"), t("{n} agree", { n: numberText(camera.landmarks) })],
  ];
  return facts.flatMap(([name, text]) => [h("dt", {}, name), h("dd", {}, text)]);
}

/** @param {Array<string|Node>} name @param {string} text */
function row(name, text) {
  return [h("dt", {}, ...name), h("dd", {}, copyButton(h("span", {}, text), () => text))];
}

function actions(page) {
  const { session, canEdit, slug } = page;
  const { query, spot, mode } = session;
  if (!query?.id || !canEdit) return [];
  if (query.adopted !== null && query.adopted !== undefined) {
    return [
      h("span", { class: "badge badge--success" }, icon("check"), t("In the map")),
      h("a", { class: "button button--quiet", href: `/maps/${slug}/edit` }, t("Show it in the editor")),
    ];
  }
  const known = Boolean(session.position);
  const label = spot ? t("Add it to the map here") : t("Right: add it to the map");
  const add = h("button", { class: "button button--primary", type: "button", id: "adopt", onclick: (event) => adopt(page, event.currentTarget) }, icon("plus"), label);
  const correcting = mode === "correct";
  const correct = h(
    "button",
    { class: "button", type: "button", id: "correct", "aria-pressed": String(correcting), onclick: () => toggle(session) },
    icon("target"), correctLabel(session, known),
  );
  return known ? [add, correct] : [correct];
}

function correctLabel({ mode, spot }, known) {
  if (mode === "correct" || spot) return known && !spot ? t("Keep the computed position") : t("Cancel");
  return known ? t("Correct the position") : t("Mark it on the map");
}

function toggle(session) {
  const back = session.mode === "correct" || session.spot;
  session.setMode(back ? "look" : "correct");
  if (back) session.setSpot(null);
  else byId("map-canvas").focus({ preventScroll: true });
}

/** Floor of a clicked position: the shown one. */
function shownFloor({ floor, floors }) {
  return floors.length ? floor : null;
}

function adopt({ session, store, server, refresh }, button) {
  return busy(button, async () => {
    const { query, hypothesis, spot } = session;
    const floor = spot ? shownFloor(store) : (hypothesis.floor ?? null);
    const [x_px, y_px] = session.position;
    try {
      const done = await server.adopt(query.id, { x_px, y_px, heading_deg: spot ? null : hypothesis.heading_deg, floor });
      if (session.query?.id === query.id) session.setQuery({ ...query, adopted: done.id });
      session.setMode("look");
      await refresh();
      toast(t("The photo was added to the map. You can undo this in the editor."));
    } catch (error) {
      toastError(error);
    }
  });
}
