/** A map to walk through: the photo, the map and the filmstrip show the same current photo. */

import { get } from "../shared/api.js";
import { byId, takesText } from "../shared/dom.js";
import { FloorSwitch } from "../shared/map/floor-switch.js";
import { MapLayers } from "../shared/map/map-layers.js";
import { MapStore } from "../shared/map/map-store.js";
import { MapView } from "../shared/map/map-view.js";
import { NorthUp } from "../shared/map/north-up.js";
import { NoteLayer } from "../shared/map/note-layer.js";
import { loadDetails } from "../shared/map/photo-details.js";
import { PhotoDots } from "../shared/map/photo-dots.js";
import { singleKeys } from "../shared/single-keys.js";
import { toastError } from "../shared/toast.js";
import { orderInAddress, photoInAddress, writeAddress } from "./address.js";
import { PhotoFrame } from "./photo.js";
import { Steps } from "./steps.js";
import { Strip } from "./strip.js";
import { Walk } from "./walk.js";
import { WholeScreen } from "./whole-screen.js";

if (document.getElementById("view")) begin();

function begin() {
  const state = JSON.parse(byId("state").textContent);
  const store = new MapStore(state);
  const walk = new Walk(store, JSON.parse(byId("walk").textContent), orderInAddress());
  const view = new MapView(byId("map-canvas"), store);
  new NorthUp(view);
  new MapLayers(view);
  new NoteLayer(store, view.map);
  new FloorSwitch(store, view.element.parentElement);
  const dots = new PhotoDots(store).addTo(view.map);
  const mark = (id) => dots.setMark(id === null ? [] : [store.position(id)]);
  /** Jumps are steps of the browser's history; the next photo of the way is none. */
  const jump = (id) => go(id, "pushState");
  const step = (by) => go(walk.after(by), "replaceState");
  const go = (id, how) => {
    if (id === null || id === store.currentId) return;
    store.setCurrent(id);
    writeAddress(id, how);
  };
  store.setCurrent(known(store, photoInAddress()) ?? walk.ids[0]);
  const { image } = new PhotoFrame(walk, step);
  const steps = new Steps(byId("steps"), walk, { go: jump, point: mark });
  steps.show();
  new Strip(walk, image, jump);
  const whole = new WholeScreen(byId("photo"), byId("photo-whole", HTMLButtonElement));
  const reveal = () => store.currentId !== null && view.reveal(store.position(store.currentId));
  store.on("current", reveal);
  reveal();
  addEventListener("popstate", () => {
    if (orderInAddress() !== walk.order) walk.choose({ order: orderInAddress() });
    store.setCurrent(known(store, photoInAddress()) ?? walk.ids[0]);
  });
  byId("photo-previous").addEventListener("click", () => step(-1));
  byId("photo-next").addEventListener("click", () => step(1));
  byId("zoom-in").addEventListener("click", () => view.zoom(1));
  byId("zoom-out").addEventListener("click", () => view.zoom(-1));
  byId("zoom-fit").addEventListener("click", () => view.fit());
  view.map.on("click", ({ containerPoint, originalEvent }) => {
    const pointer = /** @type {PointerEvent} */ (originalEvent).pointerType === "touch" ? "touch" : "mouse";
    const [id] = dots.near(containerPoint, pointer).filter((one) => one !== store.currentId);
    if (id !== undefined) jump(id);
  });
  document.addEventListener("keydown", (event) => key(event, { walk, step, jump, steps, whole }));
  const photosAfter = state.token ? `/shared/${encodeURIComponent(state.token)}/photos` : `/maps/${encodeURIComponent(state.slug)}/photos`;
  loadDetails(store, (id, most) => get(`${photosAfter}?after=${id}&limit=${most}`)).catch(toastError);
}

/** A photo that has a place on the map; else null. @param {MapStore} store @param {?number} id */
function known(store, id) {
  return id !== null && store.photos.has(id) && store.isPlaced(id) ? id : null;
}

function key(event, { walk, step, jump, steps, whole }) {
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || takesText(event.target) || document.querySelector("dialog[open]")) return;
  const scrolls = document.documentElement.scrollHeight > innerHeight;
  const keys = {
    ArrowRight: () => step(1), ArrowLeft: () => step(-1),
    Home: () => jump(walk.ids[0] ?? null), End: () => jump(walk.ids.at(-1) ?? null),
    ...(scrolls ? {} : { ArrowUp: () => jump(steps.towards(0)), ArrowDown: () => jump(steps.towards(180)) }),
    ...(singleKeys.on ? { f: () => whole.toggle(), n: () => step(1), p: () => step(-1) } : {}),
    ...(whole.on ? { Escape: () => whole.leave() } : {}),
  };
  if (!(event.key in keys)) return;
  event.preventDefault();
  keys[event.key]();
}
