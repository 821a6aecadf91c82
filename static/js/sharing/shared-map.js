/** A shared map or answer for visitors: view it, and localize photos if the owner allows it. */

import { AnswerLayer } from "../shared/answer/answer-layer.js";
import { followFloor } from "../shared/answer/answer-floor.js";
import { answerList } from "../shared/answer/answer-list.js";
import { QuerySession } from "../shared/answer/query-session.js";
import { verdictText } from "../shared/answer/verdict.js";
import { WaitingWords } from "../shared/answer/waiting-words.js";
import { get, upload } from "../shared/api.js";
import { byId } from "../shared/dom.js";
import { tn } from "../shared/i18n.js";
import { FloorSwitch } from "../shared/map/floor-switch.js";
import { MapLayers } from "../shared/map/map-layers.js";
import { MapStore } from "../shared/map/map-store.js";
import { NoteLayer } from "../shared/map/note-layer.js";
import { MapView } from "../shared/map/map-view.js";
import { NorthUp } from "../shared/map/north-up.js";
import { loadDetails } from "../shared/map/photo-details.js";
import { PhotoDots } from "../shared/map/photo-dots.js";
import { toastError } from "../shared/toast.js";
import { PhotoPanel } from "./photo-panel.js";

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
if (document.getElementById("query-input")) takePhotos(byId("query-input"));

/** Show the shared answer. */
function showShared(answer) {
  if (answer.preview) showQuery(answer.preview);
  show(answer);
}

function showQuery(address) {
  byId("query-image", HTMLImageElement).src = address;
  byId("query").hidden = false;
}

/** Show an answer instead of the plain dots. */
function show(answer) {
  dots.remove();
  marks.addTo(view.map);
  session.setAnswer(answer);
  byId("announcer").textContent = verdictText(answer);
}

function listen() {
  const look = () => session.position && view.reveal(session.position, { margin: 70 });
  answerList(session, look);
  session.on("answer", () => {
    look();
    byId("hypotheses").scrollIntoView({ block: "nearest" });
  });
  session.on("chosen", () => {
    const speaks = session.hypothesis?.experiences.find((id) => store.photos.get(id)?.preview);
    if (speaks !== undefined) store.setCurrent(speaks);
  });
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

/** Localize the visitor's photo. @param {HTMLInputElement} input */
function takePhotos(input) {
  let shown = null;
  const words = new WaitingWords(byId("busy-words"), byId("busy", HTMLProgressElement));
  const onEvent = (kind, data) => {
    words.take(kind, data);
    if (kind === "first") show(data);
  };
  input.addEventListener("change", async () => {
    const [file] = input.files;
    input.value = "";
    if (!file) return;
    if (shown) URL.revokeObjectURL(shown);
    shown = URL.createObjectURL(file);
    showQuery(shown);
    words.begin(true);
    const body = new FormData();
    body.append("file", file, file.name || "photo.jpg");
    try {
      show(await upload(`${shared}/localize`, { body, onProgress: (sent, all) => words.sent(sent, all), onEvent }));
    } catch (error) {
      toastError(error);
    }
    words.end();
  });
}
