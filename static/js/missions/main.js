/** The page of a mission: creates its parts and connects them. */

import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { connectTabs } from "../shared/tabs.js";
import { sentence, toastError } from "../shared/toast.js";
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
load();

/** Load the mission; an error is shown in place of the map. */
async function load() {
  byId("loading").hidden = false;
  byId("failed").hidden = true;
  try {
    store.setMission(await server.state());
    begin();
  } catch (error) {
    if (!error.status && error.code !== "offline") throw error;
    fail([error.message, error.hint].filter(Boolean).map(sentence).join(". "));
    byId("try-again").addEventListener("click", load, { once: true });
  } finally {
    byId("loading").hidden = true;
  }
}

function fail(text) {
  byId("failed").hidden = false;
  byId("failed-text").textContent = text;
}

function begin() {
  const view = new MissionView(byId("map-canvas"));
  const lines = new TrackLines(store, view);
  const scene = new Scene(store, lines, view);
  connectDrawings(store, view, scene);
  const player = new Player(store);
  const fit = (track = null) => {
    const boxes = (track ? [track] : store.shown.map((one) => one.track)).map(({ bounds }) => bounds).filter(Boolean);
    if (!view.ground) return;
    if (boxes.length) view.show(around(boxes));
    else if (view.ground.bounds) view.map.fitBounds(view.ground.bounds, { animate: false });
  };
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
  zoomButtons(view, fit);
  const live = new Live(store, page.id);
  connectActions(store, lines, live, page.fusion);
  state(live);
  live.start();
  firstPositions(view, fit);
}

function around(boxes) {
  const all = (axis) => boxes.map((box) => box[axis]);
  return { south: Math.min(...all(0)), west: Math.min(...all(1)), north: Math.max(...all(2)), east: Math.max(...all(3)) };
}

function zoomButtons(view, fit) {
  byId("zoom-in").addEventListener("click", () => view.map?.zoomIn());
  byId("zoom-out").addEventListener("click", () => view.map?.zoomOut());
  byId("zoom-fit").addEventListener("click", () => fit());
}

/** Show instructions while there are no positions, zoom to the first ones, and follow new ones if chosen. */
function firstPositions(view, fit) {
  const follow = byId("follow", HTMLInputElement);
  let empty = false;
  const render = () => {
    const none = !store.tracks.some(({ track }) => track.poses) && !store.mission.objects;
    byId("empty").hidden = !none;
    if (empty && !none) fit();
    empty = none;
  };
  store.on("missions grown", render);
  store.on("poses", ({ detail: { points } }) => {
    const [, , lat, lon] = points.at(-1);
    const flat = view.ground?.flat(lat, lon);
    if (flat && follow.checked && store.moment === null) view.reveal(flat, { margin: 90 });
  });
  render();
}

/** Show whether the mission is live and the page connected. */
function state(live) {
  live.addEventListener("state", liveBadge(store, () => live.connected));
  live.addEventListener("gone", () => fail(t("This mission no longer exists.")));
}
