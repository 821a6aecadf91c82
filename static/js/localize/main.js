/** The page Localize: creates its parts and connects them. */

import { colours } from "../shared/answer/answer-format.js";
import { AnswerLayer } from "../shared/answer/answer-layer.js";
import { followFloor } from "../shared/answer/answer-floor.js";
import { answerList } from "../shared/answer/answer-list.js";
import { QuerySession } from "../shared/answer/query-session.js";
import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { FloorSwitch } from "../shared/map/floor-switch.js";
import { MapLayers } from "../shared/map/map-layers.js";
import { MapPolling } from "../shared/map/map-polling.js";
import { MapStore } from "../shared/map/map-store.js";
import { MapView } from "../shared/map/map-view.js";
import { NorthUp } from "../shared/map/north-up.js";
import { loadDetails } from "../shared/map/photo-details.js";
import { connectTabs } from "../shared/tabs.js";
import { toastError } from "../shared/toast.js";
import { Batch } from "./batch.js";
import { endpointsOf } from "./endpoints.js";
import { showExplanation } from "./explanation.js";
import { AnswerGestures, instructions } from "./gestures.js";
import { LiveCamera } from "./live-camera.js";
import { Localizer } from "./localizer.js";
import { MatchPanel } from "./match-panel.js";
import { Options } from "./options.js";
import { listenToSources } from "./photo-sources.js";
import { showPlace } from "./place-panel.js";
import { QueryHistory } from "./query-history.js";
import { showQuery } from "./query-view.js";
import { connectSecondMap } from "./second-map.js";

const state = JSON.parse(byId("state").textContent);
const store = new MapStore({ ...state, can_edit: false });
const session = new QuerySession();
const server = endpointsOf(store.slug);
const live = new MapPolling(store, server.changes);

const view = new MapView(byId("map-canvas"), store);
const northUp = new NorthUp(view);
const layers = new MapLayers(view);
const marks = new AnswerLayer(store, session).addTo(view.map);
new FloorSwitch(store, byId("map"));
followFloor(session, store);
new AnswerGestures(view, marks, session, say);
instructions(session);

const options = new Options(session, store, () => askAgain());
const asking = new Localizer({ session, store, server, options, say });
const page = { session, store, server, options, asking, say, slug: store.slug, canEdit: state.can_edit, refresh: () => live.refresh() };

const openTab = connectTabs(["answer", "batch", "history"], (name) => {
  if (name === "history") past.show();
  batch.showMarks(name === "batch");
});
const open = (id) => {
  camera.stop();
  openTab("answer");
  asking.open(id);
};
const past = new QueryHistory(page, open);
const batch = new Batch(page, view, { show: () => openTab("batch"), open });
const camera = new LiveCamera(page);
showQuery(page, { forgotten: () => past.refresh() });
answerList(session, () => look());
showPlace(page);
showExplanation(session, options, () => askAgain());
new MatchPanel(page);
connectSecondMap(page, [northUp, layers]);
asking.addEventListener("asked", () => past.refresh());
asking.addEventListener("separately", async (event) => {
  asking.cancel();
  session.setAnswer(null);
  await batch.run(/** @type {CustomEvent} */ (event).detail);
  past.refresh();
});
session.on("answer", () => look());
listenToSources((files) => {
  camera.stop();
  openTab("answer");
  asking.take(files);
}, server.example);
zoomButtons();
legend();
whetherItCanAnswer();
live.start();
loadDetails(store, server.photosAfter).catch(toastError);
openLinked();

/** Announce to a screen reader. */
function say(text) {
  byId("announcer").textContent = text;
}

function askAgain() {
  if (!camera.stream) asking.again();
}

/** Bring the chosen place into view. */
function look() {
  if (session.position) view.reveal(session.position, { margin: 70 });
}

function openLinked() {
  const id = Number(new URLSearchParams(location.search).get("query"));
  if (Number.isInteger(id) && id > 0) asking.open(id);
}

function zoomButtons() {
  byId("zoom-in").addEventListener("click", () => view.zoom(1));
  byId("zoom-out").addEventListener("click", () => view.zoom(-1));
  byId("zoom-fit").addEventListener("click", () => view.fit());
}

function legend() {
  byId("legend-scale").style.backgroundImage = `linear-gradient(to right, ${colours.scale.filter((_, n) => n % 10 === 0).join(", ")})`;
  session.on("answer", () => (byId("legend").hidden = !session.answer));
}

/** Show what is missing on a map without an image or placed photos. */
function whetherItCanAnswer() {
  const render = () => {
    const placed = store.order.some((id) => store.isPlaced(id));
    const able = Boolean(store.satellite) && placed;
    byId("no-map").hidden = able;
    byId("localize").classList.toggle("lo--bare", !able);
    byId("no-map-text").textContent = store.satellite
      ? t("No photo is placed on it yet. New photos are compared with the placed ones.")
      : t("It needs an aerial image, and photos placed on it.");
  };
  store.on("photos satellite", render);
  render();
}
