/** The page of a map's image: three ways to get an image, and three to georeference it. */

import { byId } from "../shared/dom.js";
import { georeferenceSection } from "./georeference.js";
import { latLngOf } from "../shared/map/coords.js";
import { imageMap } from "../shared/map/image-map.js";
import { page, panels, showKeptNotes } from "./page.js";
import { TilesPanel } from "./tile-download.js";
import { blankForm, uploadForm } from "./upload-forms.js";

showKeptNotes();
if (page.satellite) {
  const still = { dragging: false, scrollWheelZoom: false, doubleClickZoom: false, touchZoom: false };
  const map = imageMap(byId("present-map"), page.satellite, { ...still, boxZoom: false, keyboard: false });
  for (const place of page.placed) L.circleMarker(latLngOf(place), { radius: 3, className: "sat-photo", interactive: false }).addTo(map);
}
if (page.canEdit) {
  uploadForm();
  blankForm();
  const wanted = location.hash === "#map-service";
  const proposed = Boolean(page.photos) && !page.satellite; // propose an area without contacting a service
  const tiles = new TilesPanel({ asked: wanted || !proposed, blank: () => choose("blank") });
  const choose = panels("way", (way) => way === "tiles" && tiles.open());
  if (wanted || proposed) choose("tiles");
  if (page.satellite) georeferenceSection();
}
