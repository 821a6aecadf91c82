/** A shared mission for visitors: the same views as for its owners, read-only. */

import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { connectTabs } from "../shared/tabs.js";
import { toastError } from "../shared/toast.js";
import { chooseGround } from "./background-choice.js";
import { connectDrawings } from "./drawings/connect.js";
import { connectGestures } from "./gestures.js";
import { showLegend } from "./legend.js";
import { liveBadge } from "./live-badge.js";
import { MissionView } from "./mission-view.js";
import { showObject } from "./object-card.js";
import { ObjectTable } from "./object-table.js";
import { showPhotos } from "./photos.js";
import { Player } from "./player.js";
import { Profile } from "./profile.js";
import { awaitPositions, beginWhenLoaded, connectZoom, fail, fitting } from "./page-parts.js";
import { connectReportLinks } from "./report-links.js";
import { Scene } from "./scene.js";
import { Following, SharedStore } from "./shared-store.js";
import { TrackLines } from "./track-lines.js";
import { showTracks } from "./track-panel.js";

const page = JSON.parse(byId("page").textContent);
const store = new SharedStore(page);

connectReportLinks();
beginWhenLoaded(async () => store.setMission(await store.server().state()), begin);

function begin() {
  const view = new MissionView(byId("map-canvas"));
  const lines = new TrackLines(store, view);
  const scene = new Scene(store, lines, view);
  connectDrawings(store, view, scene);
  const player = new Player(store);
  const fit = fitting(view, store);
  const look = ({ lat, lon }) => view.ground && view.reveal(view.ground.flat(lat, lon));
  connectGestures({ view, scene, store, player, fit: () => fit() });
  showLegend(store, lines); // first, as it takes width from the map that is fitted below
  chooseGround(store, view, { services: page.services, maps: page.maps, fit });
  lines.load().catch(toastError);
  showTracks(store, { fit, forget: () => {} });
  new Profile(store, scene, player);
  connectTabs(["tracks", "objects", "areas", "photos"]);
  byId("panel").inert = false; // inert until its listeners are attached
  showObject(store);
  new ObjectTable(store, look);
  showPhotos(store, look);
  connectZoom(view, fit);
  awaitPositions(store, fit);
  follow(view);
}

/** Show whether the mission is live, and follow new data. */
function follow(view) {
  const following = new Following(store);
  store.on("missed", () => {
    const newest = store.shown.map(({ track }) => track.last).filter(Boolean).sort((a, b) => b.time_s - a.time_s)[0];
    const flat = newest && view.ground?.flat(newest.lat, newest.lon);
    if (flat && byId("follow", HTMLInputElement).checked && store.moment === null) view.reveal(flat, { margin: 90 });
  });
  following.addEventListener("state", liveBadge(store, () => following.connected));
  following.addEventListener("gone", () => fail(t("This link is no longer valid.")));
  following.start();
}
