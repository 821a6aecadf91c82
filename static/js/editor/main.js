/** The page to place photos on the image of a map: creates its parts and connects them. */

import { isAmong } from "../shared/accepted.js";
import { byId, targetOf } from "../shared/dom.js";
import { listenToDrops, listenToPastes, usable } from "../shared/drop-files.js";
import { takeNotes } from "../shared/kept-notes.js";
import { latLngOf } from "../shared/map/coords.js";
import { Crosshair } from "../shared/map/crosshair.js";
import { FloorSwitch } from "../shared/map/floor-switch.js";
import { MapLayers } from "../shared/map/map-layers.js";
import { MapPolling } from "../shared/map/map-polling.js";
import { MapStore } from "../shared/map/map-store.js";
import { MapView } from "../shared/map/map-view.js";
import { Measure } from "../shared/map/measure.js";
import { NorthUp } from "../shared/map/north-up.js";
import { loadDetails } from "../shared/map/photo-details.js";
import { PhotoDots } from "../shared/map/photo-dots.js";
import { printDialog } from "../shared/print-dialog.js";
import { toast, toastError } from "../shared/toast.js";
import { isSidecar } from "../shared/sidecars.js";
import { Uploads } from "../shared/uploads.js";
import { Activity } from "./activity.js";
import { bulkPlacing } from "./bulk-placing.js";
import { ChecksPanel } from "./checks.js";
import { Commands } from "./commands.js";
import { EditQueue } from "./edit-queue.js";
import { endpointsOf } from "./endpoints.js";
import { AlignFloor } from "./floors/align-floor.js";
import { connectFloors } from "./floors/floors-dialog.js";
import { EditGestures } from "./gestures.js";
import { showHelp } from "./help.js";
import { connectKeyboard } from "./keyboard.js";
import { connectLayout } from "./layout.js";
import { MapHealth } from "./map-health.js";
import { connectBlurBar } from "./photos/blur-photos.js";
import { CurrentPhoto } from "./photos/current-photo.js";
import { previewDots } from "./photos/dot-preview.js";
import { dropPhotos } from "./photos/drop-photos.js";
import { connectFilters } from "./photos/filter-bar.js";
import { PhotoGrid } from "./photos/photo-grid.js";
import { PhotoMenu } from "./photos/photo-menu.js";
import { PhotoOrder } from "./photos/photo-order.js";
import { openViewer } from "./photos/photo-viewer.js";
import { connectSelection } from "./photos/selection-bar.js";
import { Notes } from "./notes.js";
import { choosePlacement } from "./placements.js";
import { satelliteInput } from "./satellite-input.js";
import { connectUndoRedo } from "./undo-redo.js";

const store = new MapStore(JSON.parse(byId("state").textContent));
const server = endpointsOf(store.slug);
const live = new MapPolling(store, server.changes);
const refresh = () => live.refresh();
const edits = new EditQueue(store, server, refresh);
const order = new PhotoOrder(store);
const commands = new Commands(store, edits, order, say);
connectLayout(store);

const view = new MapView(byId("map-canvas"), store);
const northUp = new NorthUp(view, { ownKey: false });
new MapLayers(view);
const dots = new PhotoDots(store).addTo(view.map);
const gestures = new EditGestures(view, dots, commands);
const crosshair = new Crosshair(view, say);
const measure = new Measure({ element: view.element, map: view.map, latLng: latLngOf, latLon: (pixel) => store.georeference.latLon(pixel) }, say);
store.on("satellite", () => measure.stop());
const align = new AlignFloor({ store, server, view, say });
gestures.interceptors = [measure, align];
new FloorSwitch(store, byId("map"));
const page = { store, server, refresh, view, dots, gestures, crosshair, measure, northUp, commands, say, help: showHelp };

new CurrentPhoto(commands, view, server);
const menu = new PhotoMenu(commands, order, { ...page, notes: new Notes(page) });
new PhotoGrid(commands, order, { open: () => openViewer(commands), menu: (id, at) => menu.ofPhoto(id, at) });
connectFilters(order, store);
connectSelection(commands);
dropPhotos(view, commands);
previewDots(view, dots, gestures);
new ChecksPanel(store, server, page);
new MapHealth(page);
connectUndoRedo(commands);
choosePlacement(page);
connectFloors({ store, server, align });
satelliteInput(store, server, refresh);
connectKeyboard(page);
chooseFirst();
takeFiles();
zoomButtons();
byId("help").addEventListener("click", showHelp);
closeChosen();
byId("print-map").addEventListener("click", (event) => {
  targetOf(event).closest("details").open = false;
  printDialog(store);
});
live.start();
loadDetails(store, server.photosAfter).catch(toastError);
for (const { text } of takeNotes()) toast(text);

/** Announce to a screen reader. */
function say(text) {
  byId("announcer").textContent = text;
}

/** Keep a current photo whenever there are photos; end placing if someone else has placed it. */
function chooseFirst() {
  const choose = () => {
    const gone = store.currentId === null || !store.photos.has(store.currentId);
    if (gone && store.order.length) store.setCurrent(store.unplaced()[0] ?? store.order[0]);
    else if (store.tool === "place" && store.isPlaced(store.currentId)) store.setTool("select");
  };
  store.on("photos", choose);
  store.on("current", () => {
    const position = store.currentId === null ? null : store.position(store.currentId);
    if (position && !gestures.gesture) view.reveal(position);
  });
  const linked = Number(new URLSearchParams(location.search).get("photo") ?? NaN);
  if (store.photos.has(linked)) store.setCurrent(linked);
  choose();
}

/** Upload photos; open the matching dialog for lists of positions and tracks. */
function takeFiles() {
  const uploads = new Uploads(server, store);
  new Activity(store, uploads, page);
  if (!store.canEdit) return;
  const bulk = bulkPlacing(page);
  connectBlurBar(page);
  const take = async (files) => {
    const lists = files.filter((file) => isAmong(file, "positions"));
    const photos = files.filter((file) => !lists.includes(file));
    if (photos.length) uploads.add(files.filter((file) => !lists.includes(file) || isSidecar(file)));
    else if (lists.length) (await isTrack(lists[0]) ? bulk.track : bulk.positions)(lists[0]);
  };
  listenToDrops(byId("drop"), take);
  listenToPastes(take);
  for (const input of [byId("photo-input", HTMLInputElement), byId("folder-input", HTMLInputElement)]) {
    input.addEventListener("change", () => {
      const files = usable(input.files);
      input.value = "";
      take(files);
    });
  }
  byId("folder-button").addEventListener("click", () => byId("folder-input").click());
}

/** Close a menu of the toolbar before what was chosen in it opens. */
function closeChosen() {
  byId("toolbar").addEventListener("click", (event) => {
    const item = targetOf(event).closest(".menu__item");
    if (item) item.closest("details").open = false;
  }, { capture: true });
}

/** Whether a file is a track; a GPX file with only waypoints is a list of positions. @param {File} file */
async function isTrack(file) {
  return isAmong(file, "tracks_of_photos") && (await file.text()).includes("<trkpt");
}

function zoomButtons() {
  byId("zoom-in").addEventListener("click", () => view.zoom(1));
  byId("zoom-out").addEventListener("click", () => view.zoom(-1));
  byId("zoom-fit").addEventListener("click", () => view.fit());
}
