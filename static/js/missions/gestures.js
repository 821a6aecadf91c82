/** Mouse, touch and keys on the map. */

import { h, takesText, targetOf } from "../shared/dom.js";
import { Measure } from "../shared/map/measure.js";
import { singleKeys } from "../shared/single-keys.js";

const PAN = { ArrowLeft: [-80, 0], ArrowRight: [80, 0], ArrowUp: [0, -80], ArrowDown: [0, 80] };

/**
 * @param {Object} page
 * @param {import("./mission-view.js").MissionView} page.view
 * @param {import("./scene.js").Scene} page.scene
 * @param {import("./mission-store.js").MissionStore} page.store
 * @param {import("./player.js").Player} page.player
 * @param {function(): void} page.fit shows everything
 */
export function connectGestures({ view, scene, store, player, fit }) {
  const measure = measureOn(view);
  view.addEventListener("ground", () => {
    view.map.on("click", ({ containerPoint, latlng, originalEvent }) => {
      if (measure.active) return void (originalEvent.detail < 2 && addTo(measure, view, latlng)); // the second of a double click zooms
      const [spot] = scene.near(containerPoint, /** @type {PointerEvent} */ (originalEvent).pointerType === "touch" ? "touch" : "mouse");
      store.choose(spot ? spot.key : null);
    });
    view.map.on("mousemove", ({ containerPoint }) => view.element.classList.toggle("is-on-dot", scene.near(containerPoint).length > 0));
  });
  const keys = { "+": () => view.zoom(1), "=": () => view.zoom(1), "-": () => view.zoom(-1), 0: fit };
  view.element.addEventListener("keydown", (event) => {
    if (!view.map || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Enter" && measure.active) addTo(measure, view, view.map.getCenter());
    else if (PAN[event.key]) view.map.panBy(PAN[event.key], { animate: false });
    else if (keys[event.key]) keys[event.key]();
    else return;
    event.preventDefault();
  });
  addEventListener("keydown", (event) => {
    const { key } = event;
    const target = targetOf(event);
    if (event.ctrlKey || event.metaKey || event.altKey || takesText(target) || document.querySelector("dialog[open]")) return;
    if (key === " " && !target.closest("button, summary, a, input")) player.toggle();
    else if (key === "," || key === ".") player.step(key === "." ? 1 : -1);
    else if (key.toLowerCase() === "d" && singleKeys.on) measure.toggle();
    else if (key === "Escape" && !target.closest("details.menu")) measure.active ? measure.stop() : store.choose(null);
    else return;
    if (key !== "Escape") event.preventDefault();
  });
}

/** The tool that measures, in latitude and longitude. @param {import("./mission-view.js").MissionView} view */
function measureOn(view) {
  view.element.append(h("div", { class: "ed-crosshair mi-middle", "aria-hidden": "true" }));
  const measure = new Measure({
    element: view.element,
    get map() {
      return view.map;
    },
    latLng: ([lat, lon]) => {
      const flat = view.ground.flat(lat, lon);
      return flat && view.ground.latLngOf(flat);
    },
    latLon: (place) => place,
  });
  view.addEventListener("ground", () => measure.show());
  return measure;
}

/** @param {Measure} measure @param {import("./mission-view.js").MissionView} view @param {L.LatLng} latLng */
function addTo(measure, view, latLng) {
  const place = view.ground.latLonOf(latLng);
  if (place) measure.add(place);
}
