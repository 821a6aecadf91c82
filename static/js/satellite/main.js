/** The page of a map's image: three ways to it, and three to where it is on the Earth. */

import { imageMap } from "./imagemap.js";
import { byId, page, panels, showKeptNotes } from "./page.js";
import { blankForm, uploadForm } from "./plain.js";
import { TilesPanel } from "./tiles.js";
import { whereSection } from "./where.js";

showKeptNotes();
if (page.satellite) {
  const still = { zoomControl: false, dragging: false, scrollWheelZoom: false, doubleClickZoom: false, touchZoom: false };
  imageMap(byId("present-map"), page.satellite, { ...still, boxZoom: false, keyboard: false });
}
if (page.canEdit) {
  uploadForm();
  blankForm();
  const tiles = new TilesPanel();
  panels("way", (way) => way === "tiles" && tiles.open());
  if (page.satellite) whereSection();
}
