/** A shared map or answer for visitors: view it, and localize photos if the owner allows it. */

import { AnswerLayer } from "../shared/answer/answer-layer.js";
import { followFloor } from "../shared/answer/answer-floor.js";
import { answerList, placeName } from "../shared/answer/answer-list.js";
import { QuerySession } from "../shared/answer/query-session.js";
import { verdictText } from "../shared/answer/verdict.js";
import { get } from "../shared/api.js";
import { byId } from "../shared/dom.js";
import { headingText } from "../shared/format.js";
import { t, tn } from "../shared/i18n.js";
import { FloorSwitch } from "../shared/map/floor-switch.js";
import { MapLayers } from "../shared/map/map-layers.js";
import { MapStore } from "../shared/map/map-store.js";
import { NoteLayer } from "../shared/map/note-layer.js";
import { MapView } from "../shared/map/map-view.js";
import { NorthUp } from "../shared/map/north-up.js";
import { loadDetails } from "../shared/map/photo-details.js";
import { PhotoDots } from "../shared/map/photo-dots.js";
import { copyablePlace } from "../shared/map/positions.js";
import { factElements } from "../shared/photo-facts.js";
import { toastError } from "../shared/toast.js";
import { contribute } from "./contribute.js";
import { PhotoPanel } from "./photo-panel.js";
import { VisitorPhoto } from "./visitor-photo.js";

const PAN = { ArrowLeft: [-80, 0], ArrowRight: [80, 0], ArrowUp: [0, -80], ArrowDown: [0, 80] };

const state = JSON.parse(byId("state").textContent);
const shared = `/shared/${encodeURIComponent(state.token)}`;
const store = new MapStore(state);
const session = new QuerySession();
const view = new MapView(byId("map-canvas"), store);
new NorthUp(view);
new MapLayers(view);
const dots = new PhotoDots(store).addTo(view.map);
const marks = new AnswerLayer(store, session);

byId("about").textContent = tn("{n} photo", "{n} photos", store.photos.size);
new PhotoPanel(store, view);
new NoteLayer(store, view.map);
new FloorSwitch(store, view.element.parentElement);
followFloor(session, store);
listen();
zoomButtons();
loadDetails(store, (id, most) => get(`${shared}/photos?after=${id}&limit=${most}`)).catch(toastError);
if (state.answer) showShared(state.answer);
if (document.getElementById("give-input")) contribute(`${shared}/contributions`);
if (document.getElementById("query-input")) new VisitorPhoto(session, `${shared}/localize`);

function showShared(answer) {
  if (answer.preview) session.setQuery({ preview: answer.preview });
  session.setAnswer(answer);
}

function showQuery() {
  const { preview, url, name = "" } = session.query;
  byId("query-image", HTMLImageElement).src = preview || url;
  byId("query-name").textContent = name;
  byId("query").hidden = false;
}

/** Show an answer instead of the plain dots; without one, the dots. */
function showMarks() {
  const { answer } = session;
  (answer ? dots : marks).remove();
  (answer ? marks : dots).addTo(view.map);
  byId("announcer").textContent = answer ? verdictText(answer) : "";
}

/** Where the chosen place is, to read out or to copy. */
function showPlaceFacts() {
  const { position, hypothesis } = session;
  const latLon = position && store.georeference.latLon(position);
  const facts = [
    latLon && [placeName(hypothesis), copyablePlace(latLon)],
    position && hypothesis.heading_deg !== null && [t("Heading"), headingText(hypothesis.heading_deg)],
  ].filter(Boolean);
  byId("answer-facts").replaceChildren(...factElements(facts));
  byId("answer-facts").hidden = !facts.length;
}

function listen() {
  const look = () => session.position && view.reveal(session.position, { margin: 70 });
  answerList(session, look);
  session.on("query", showQuery);
  session.on("answer", () => {
    showMarks();
    look();
    if (session.answer) byId("hypotheses").scrollIntoView({ block: "nearest" });
  });
  session.on("chosen", () => {
    const speaks = session.hypothesis?.experiences.find((id) => store.photos.get(id)?.preview);
    store.setCurrent(speaks ?? null);
  });
  session.on("answer chosen", showPlaceFacts);
  store.on("current", advised);
  session.on("answer", advised);
  view.map.on("click", ({ containerPoint, originalEvent }) => {
    const pointer = /** @type {PointerEvent} */ (originalEvent).pointerType === "touch" ? "touch" : "mouse";
    if (session.answer) {
      const [rank] = marks.near(containerPoint, pointer);
      if (rank !== undefined) session.choose(rank);
      return;
    }
    const [id] = dots.near(containerPoint, pointer);
    if (id !== undefined) store.setCurrent(id);
  });
  view.element.addEventListener("keydown", (event) => {
    if (!PAN[event.key]) return;
    event.preventDefault();
    view.map.panBy(PAN[event.key], { animate: false });
  });
}

/** Remove the advice once it was followed. */
function advised() {
  document.getElementById("advice")?.remove();
}

function zoomButtons() {
  byId("zoom-in").addEventListener("click", () => view.zoom(1));
  byId("zoom-out").addEventListener("click", () => view.zoom(-1));
  byId("zoom-fit").addEventListener("click", () => view.fit());
}
