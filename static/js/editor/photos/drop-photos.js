/** Photos that are dragged from the grid and dropped on the image. */

import { isInside } from "../../shared/map/coords.js";

/** Data type of a drag from the grid: the ids as JSON. */
export const PHOTOS_TYPE = "application/x-expmap-photos";

/**
 * Place photos where they are dropped.
 * @param {import("../../shared/map/map-view.js").MapView} view
 * @param {import("../commands.js").Commands} commands
 */
export function dropPhotos(view, commands) {
  const { element, store } = view;
  const dragged = (event) => store.canEdit && store.satellite && event.dataTransfer.types.includes(PHOTOS_TYPE);
  element.addEventListener("dragover", (event) => {
    if (!dragged(event)) return;
    event.preventDefault();
    element.classList.add("is-drop");
    view.showPosition(view.pixelAt(event));
  });
  element.addEventListener("dragleave", () => element.classList.remove("is-drop"));
  element.addEventListener("drop", (event) => {
    if (!dragged(event)) return;
    event.preventDefault();
    element.classList.remove("is-drop");
    const pixel = view.pixelAt(event);
    if (isInside(pixel, store.satellite)) commands.placeAt(JSON.parse(event.dataTransfer.getData(PHOTOS_TYPE)), pixel);
    else commands.warnOutside();
  });
}
