/** What the pages of a mission and of a shared one have in common. */

import { byId } from "../shared/dom.js";
import { sentence } from "../shared/toast.js";

/**
 * Load the mission, then begin; an error is shown in place of the map.
 * @param {() => Promise<void>} load
 * @param {() => void} begin
 */
export async function beginWhenLoaded(load, begin) {
  byId("loading").hidden = false;
  byId("failed").hidden = true;
  try {
    await load();
    begin();
  } catch (error) {
    if (!error.status && error.code !== "offline") throw error;
    fail([error.message, error.hint].filter(Boolean).map(sentence).join(". "));
    byId("try-again").addEventListener("click", () => beginWhenLoaded(load, begin), { once: true });
  } finally {
    byId("loading").hidden = true;
  }
}

/** Show a text in place of the map. @param {string} text */
export function fail(text) {
  byId("failed").hidden = false;
  byId("failed-text").textContent = text;
}

/** Make the function that zooms to a track, by default to all that are shown, else to the background. */
export function fitting(view, store) {
  return (track = null) => {
    const tracks = track ? [track] : store.shown.map((one) => one.track);
    const boxes = tracks.map(({ bounds }) => bounds).filter(Boolean);
    if (!view.ground) return;
    if (boxes.length) view.show(around(boxes));
    else if (view.ground.bounds) view.map.fitBounds(view.ground.bounds, { animate: false });
  };
}

function around(boxes) {
  const all = (axis) => boxes.map((box) => box[axis]);
  return { south: Math.min(...all(0)), west: Math.min(...all(1)), north: Math.max(...all(2)), east: Math.max(...all(3)) };
}

export function connectZoom(view, fit) {
  byId("zoom-in").addEventListener("click", () => view.map?.zoomIn());
  byId("zoom-out").addEventListener("click", () => view.map?.zoomOut());
  byId("zoom-fit").addEventListener("click", () => fit());
}

/** Show instructions while there are no positions, and zoom to the first ones. */
export function awaitPositions(store, fit) {
  let empty = false;
  const render = () => {
    const none = !store.tracks.some(({ track }) => track.poses) && !store.mission.objects;
    byId("empty").hidden = !none;
    if (empty && !none) fit();
    empty = none;
  };
  store.on("missions grown", render);
  render();
}
