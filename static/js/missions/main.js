/** The page of a mission: creates its parts and connects them. */

import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { connectTabs } from "../shared/tabs.js";
import { toastError } from "../shared/toast.js";
import { connectActions } from "./actions.js";
import { chooseGround } from "./background-choice.js";
import { connectDrawings } from "./drawings/connect.js";
import { showFixes } from "./fixes.js";
import { connectGestures } from "./gestures.js";
import { showLegend } from "./legend.js";
import { liveBadge } from "./live-badge.js";
import { Live } from "./live-events.js";
import { MissionStore } from "./mission-store.js";
import { MissionView } from "./mission-view.js";
import { showObject } from "./object-card.js";
import { ObjectTable } from "./object-table.js";
import { otherMissions } from "./other-missions.js";
import { showPhotos } from "./photos.js";
import { Player } from "./player.js";
import { Profile } from "./profile.js";
import { awaitPositions, beginWhenLoaded, connectZoom, fail, fitting } from "./page-parts.js";
import { connectReportLinks } from "./report-links.js";
import { showRobots } from "./robots.js";
import { Scene } from "./scene.js";
import { TaskList } from "./task-list.js";
import { TrackLines } from "./track-lines.js";
import { showTracks } from "./track-panel.js";


const page = JSON.parse(byId("page").textContent);
const store = new MissionStore(page.id, page.symbols);
const server = store.server(page.id);

connectReportLinks();
beginWhenLoaded(async () => store.setMission(await server.state()), begin);

function begin() {
  const view = new MissionView(byId("map-canvas"));
  const lines = new TrackLines(store, view);
  const scene = new Scene(store, lines, view);
  connectDrawings(store, view, scene);
  const player = new Player(store);
  const fit = fitting(view, store);
  connectGestures({ view, scene, store, player, fit: () => fit() });
  showLegend(store, lines); // first, as it takes width from the map that is fitted below
  chooseGround(store, view, { services: page.services, maps: page.maps, fit });
  lines.load().catch(toastError);
  showTracks(store, { fit, forget: otherMissions(store, fit) });
  showRobots(store);
  new Profile(store, scene, player);
  connectTabs(["tracks", "objects", "tasks", "areas", "photos"], (name) => (byId("mission").dataset.tab = name));
  byId("panel").inert = false; // inert until its listeners are attached
  showObject(store);
  const look = ({ lat, lon }) => view.ground && view.reveal(view.ground.flat(lat, lon));
  new ObjectTable(store, look);
  new TaskList(store, look);
  showFixes(store);
  showPhotos(store, look);
  connectZoom(view, fit);
  const live = new Live(store, page.id);
  connectActions(store, lines, live, page.fusion);
  state(live);
  live.start();
  awaitPositions(store, fit);
  follow(view);
}

/** Follow new positions if chosen. */
function follow(view) {
  const chosen = byId("follow", HTMLInputElement);
  store.on("poses", ({ detail: { points } }) => {
    const [, , lat, lon] = points.at(-1);
    const flat = view.ground?.flat(lat, lon);
    if (flat && chosen.checked && store.moment === null) view.reveal(flat, { margin: 90 });
  });
}

/** Show whether the mission is live and the page connected. */
function state(live) {
  live.addEventListener("state", liveBadge(store, () => live.connected));
  live.addEventListener("gone", () => fail(t("This mission no longer exists.")));
}
