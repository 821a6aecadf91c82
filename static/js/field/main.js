/** The page for the field: keeps photos on the device, sends them once online, and shows the answers on the map. */

import { AnswerLayer } from "../shared/answer/answer-layer.js";
import { followFloor } from "../shared/answer/answer-floor.js";
import { answerList } from "../shared/answer/answer-list.js";
import { QuerySession } from "../shared/answer/query-session.js";
import { get } from "../shared/api.js";
import { byId, h, metaOf, targetOf } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { FloorSwitch } from "../shared/map/floor-switch.js";
import { MapLayers } from "../shared/map/map-layers.js";
import { MapStore } from "../shared/map/map-store.js";
import { NoteLayer } from "../shared/map/note-layer.js";
import { MapView } from "../shared/map/map-view.js";
import { NorthUp } from "../shared/map/north-up.js";
import { toastError } from "../shared/toast.js";
import { Guide } from "./guide.js";
import { Outbox } from "./outbox.js";
import { PhotoList } from "./photo-list.js";
import { PhonePose } from "./pose.js";
import { PositionLayer } from "./position-layer.js";
import { Sender } from "./sender.js";

const LAST = "expmap-field-map";
const account = Number(metaOf("expmap-account").content);
const session = new QuerySession();
const photos = new PhotoList(byId("outbox"), { open, remove: (entry) => outbox.remove([entry.key]) });
const outbox = await Outbox.open(account);
const sender = new Sender(outbox);
/** @type {{slug: ?string, guide: ?Guide}} */
const shown = { slug: null, guide: null };

outbox.addEventListener("change", render);
sender.addEventListener("state", status);
const inputs = ["shot-input", "photo-input"].map((id) => byId(id, HTMLInputElement));
for (const input of inputs) input.addEventListener("change", take);
byId("spot-input", HTMLInputElement).addEventListener("change", takeAtSpot);
byId("send").addEventListener("click", () => sender.send().catch(toastError));
byId("clear").addEventListener("click", clear);
byId("insecure").hidden = isSecureContext;
navigator.storage?.persist?.(); // so that the browser does not evict photos to free storage
await render();
sender.start().catch(toastError);
const mapShown = chooseMap().catch((error) => (error.code === "offline" ? nothing(t("Open this page once while online: then the map is available offline.")) : toastError(error)));

/** Store new photos before sending them. */
async function take(event) {
  const input = targetOf(event, HTMLInputElement);
  const files = [...input.files];
  input.value = "";
  if (!files.length) return;
  try {
    await outbox.add(files, shown.slug);
    await sender.send();
  } catch (error) {
    toastError(error);
  }
}

/** Store a photo of the present spot of the plan, and go on to the next one. */
async function takeAtSpot(event) {
  const input = targetOf(event, HTMLInputElement);
  const files = [...input.files];
  input.value = "";
  const { guide } = shown;
  const spot = guide?.target;
  if (!files.length || !spot) return;
  const { number } = guide.current; // another spot may be chosen while the photo is stored
  try {
    await outbox.add(files, shown.slug, { spot });
    guide.photographed(number);
    await sender.send();
  } catch (error) {
    toastError(error);
  }
}

async function render() {
  const entries = await outbox.all();
  photos.show(entries);
  byId("outbox-none").hidden = entries.length > 0;
  byId("clear-part").hidden = !entries.some(isSettled);
  status(entries);
}

/** Show how many photos are waiting to be sent, and why. */
async function status(given) {
  const entries = Array.isArray(given) ? given : await outbox.all();
  const waiting = entries.filter(({ state }) => state === "waiting").length;
  const line = byId("waiting");
  line.textContent = waiting ? tn("waiting: {n} photo", "waiting: {n} photos", waiting) : t("Nothing waiting");
  line.dataset.count = String(waiting);
  line.classList.toggle("is-waiting", waiting > 0);
  byId("send").hidden = !waiting || sender.busy;
  const { problem } = sender;
  byId("problem").hidden = !waiting || !problem;
  if (problem) byId("problem").textContent = problem.code === "offline" ? t("You are offline. They are sent as soon as you are online.") : problem.message;
}

async function clear() {
  const entries = await outbox.all();
  session.setAnswer(null);
  await outbox.remove(entries.filter(isSettled).map(({ key }) => key));
}

/** @param {import("./outbox.js").Entry} entry */
function isSettled({ state }) {
  return state === "answered" || state === "added";
}

/** Once the service worker is active, repeat requests made before it, so that it caches them. */
function keepWhatIsSeen() {
  navigator.serviceWorker?.addEventListener("controllerchange", async () => {
    await mapShown;
    await get("/maps");
    if (!shown.slug) return;
    const state = await get(`/maps/${encodeURIComponent(shown.slug)}`);
    await get(`/maps/${encodeURIComponent(shown.slug)}/photo-plan`);
    for (const image of [state.satellite, ...state.floors]) if (image?.url) new Image().src = image.url;
  }, { once: true });
}

/** Fill the list of maps, which may come from the cache, and show the last one chosen. */
async function chooseMap() {
  if (!navigator.serviceWorker?.controller) keepWhatIsSeen();
  const { maps } = await get("/maps", { patient: false });
  const choice = byId("field-map", HTMLSelectElement);
  choice.replaceChildren(...maps.map(({ slug, name }) => h("option", { value: slug }, name)));
  const wanted = [new URLSearchParams(location.search).get("map"), localStorage.getItem(LAST)];
  const slug = wanted.find((one) => maps.some((map) => map.slug === one)) || maps[0]?.slug;
  choice.addEventListener("change", () => location.assign(`/field?map=${encodeURIComponent(choice.value)}`));
  if (!slug) return nothing(t("No maps yet."));
  choice.value = slug;
  localStorage.setItem(LAST, slug);
  shown.slug = slug;
  for (const input of inputs) input.disabled = false;
  return showMap(await get(`/maps/${encodeURIComponent(slug)}`, { patient: false }));
}

function showMap(state) {
  const satellite = state.satellite && { ...state.satellite, tiles: null }; // a single picture is easier to cache than tiles
  const store = new MapStore({ ...state, satellite, can_edit: false });
  const view = new MapView(byId("map-canvas"), store);
  new NorthUp(view);
  new MapLayers(view);
  const marks = new AnswerLayer(store, session).addTo(view.map);
  new NoteLayer(store, view.map);
  new FloorSwitch(store, view.element.parentElement);
  followFloor(session, store);
  const look = () => session.position && view.reveal(session.position, { margin: 70 });
  answerList(session, look);
  session.on("answer", look);
  view.map.on("click", ({ containerPoint }) => {
    const [rank] = marks.near(containerPoint, "touch");
    if (rank !== undefined) session.choose(rank);
  });
  byId("zoom-in").addEventListener("click", () => view.zoom(1));
  byId("zoom-out").addEventListener("click", () => view.zoom(-1));
  byId("zoom-fit").addEventListener("click", () => view.fit());
  byId("map-canvas").dataset.ready = state.slug;
  const pose = new PhonePose();
  if (satellite) new PositionLayer(view, pose);
  if (state.can_edit && satellite) leadThrough(view, state, pose);
  if (!satellite) nothing(t("This map has no image yet."));
}

/** Guide people who may add photos through the map's plan, if it has one. */
function leadThrough(view, state, pose) {
  byId("plan-editor", HTMLAnchorElement).href = `/maps/${encodeURIComponent(state.slug)}/edit`;
  shown.guide = new Guide(view, state, pose);
  shown.guide.load().catch((error) => error.code === "offline" || toastError(error));
}

function nothing(text) {
  byId("no-map").hidden = false;
  byId("no-map-text").textContent = text;
}

/** Show the answer to a photo. @param {import("./outbox.js").Entry} entry */
async function open(entry) {
  await mapShown;
  if (entry.map !== shown.slug) {
    location.assign(`/field?map=${encodeURIComponent(entry.map)}`);
    return;
  }
  photos.mark(entry.key);
  byId("answer-name").textContent = entry.name;
  byId("answer-link", HTMLAnchorElement).href = `/maps/${encodeURIComponent(entry.map)}/localize?query=${entry.answer.id}`;
  session.setAnswer(entry.answer);
  byId("answer").scrollIntoView({ block: "nearest" });
}
