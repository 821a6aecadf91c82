/** The page that tells where a photo was taken: makes the parts and connects them. */

import { MapView } from "../editor/mapview.js";
import { Live } from "../editor/live.js";
import { Store } from "../editor/store.js";
import { byId } from "../editor/page.js";
import { t } from "../i18n.js";
import { answerList } from "./answerlist.js";
import { Asking } from "./asking.js";
import { secondMap } from "./beside.js";
import { endpointsOf } from "./endpoints.js";
import { History } from "./history.js";
import { LiveCamera } from "./livecamera.js";
import { Marks } from "./marks.js";
import { Matches } from "./matches.js";
import { Options } from "./options.js";
import { showPlace } from "./place.js";
import { instructions, Pointing } from "./pointing.js";
import { showQuery } from "./queryview.js";
import { Session } from "./session.js";
import { listenToSources } from "./sources.js";
import { connectTabs } from "./tabs.js";
import { showWhy } from "./why.js";
import { colours } from "./words.js";

const state = JSON.parse(byId("state").textContent);
const store = new Store({ ...state, can_edit: false });
const session = new Session();
const server = endpointsOf(store.slug);
const live = new Live(store, server.changes);

const view = new MapView(byId("map-canvas"), store);
const marks = new Marks(store, session).addTo(view.map);
new Pointing(view, marks, session, say);
instructions(session);

const options = new Options(session, store, () => askAgain());
const asking = new Asking({ session, store, server, options, say });
const page = { session, store, server, options, asking, say, slug: store.slug, canEdit: state.can_edit, refresh: () => live.refresh() };

const openTab = connectTabs((name) => name === "history" && past.show());
const past = new History(page, (id) => {
  camera.stop();
  openTab("answer");
  asking.open(id);
});
const camera = new LiveCamera(page);
showQuery(page, { forgotten: () => past.refresh() });
answerList(session, () => look());
showPlace(page);
showWhy(session, options, () => askAgain());
new Matches(page);
secondMap(page);
asking.addEventListener("asked", () => past.refresh());
session.on("answer", () => look());
listenToSources((files) => {
  camera.stop();
  openTab("answer");
  asking.take(files);
});
zoomButtons();
legend();
whetherItCanAnswer();
live.start();
openLinked();

/** Tell a screen reader. */
function say(text) {
  byId("announcer").textContent = text;
}

function askAgain() {
  if (!camera.stream) asking.again();
}

/** The chosen place is in sight, without moving what is in sight already. */
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

/** A map without an image or without placed photos says what it needs. */
function whetherItCanAnswer() {
  const render = () => {
    const placed = store.order.some((id) => store.isPlaced(id));
    byId("no-map").hidden = Boolean(store.satellite) && placed;
    byId("no-map-text").textContent = store.satellite
      ? t("No photo has a place on it. Photos with places are what a new photo is compared with.")
      : t("It needs an image from above, and photos with places on it.");
  };
  store.on("photos satellite", render);
  render();
}
