/** Context menus of photos in the grid, of dots, and of the image. */

import { copy } from "../../shared/clipboard.js";
import { openContextMenu } from "../../shared/context-menu.js";
import { t, tn } from "../../shared/i18n.js";
import { isInside } from "../../shared/map/coords.js";
import { placeToCopy } from "../../shared/map/positions.js";
import { floorDialog } from "../floors/floor-dialog.js";
import { headingDialog } from "./heading-dialog.js";
import { openViewer } from "./photo-viewer.js";
import { timeDialog } from "./time-dialog.js";

/** Menus of photos and of the image. */
export class PhotoMenu {
  /**
   * @param {import("../commands.js").Commands} commands
   * @param {import("./photo-order.js").PhotoOrder} order
   * @param {{view: Object, dots: Object, crosshair: Object, measure: Object, notes: Object}} page
   */
  constructor(commands, order, { view, dots, crosshair, measure, notes }) {
    this.commands = commands;
    this.order = order;
    this.store = commands.store;
    this.view = view;
    this.measure = measure;
    this.notes = notes;
    view.element.addEventListener("contextmenu", (event) => {
      event.preventDefault();
      if (event.pointerType === "touch" || !this.store.satellite) return; // a long press selects
      const byKey = crosshair.visible && event.button !== 2;
      const point = byKey ? crosshair.point : view.map.mouseEventToContainerPoint(event);
      const { left, top } = view.element.getBoundingClientRect();
      const at = { x: left + point.x, y: top + point.y };
      const [hit] = dots.near(point);
      if (hit === undefined) this._ofImage(byKey ? crosshair.pixel : view.pixelAt(event), at);
      else this.ofPhoto(hit, at);
    });
  }

  /** Open the menu of a photo, or of the selection if the photo is in it. */
  ofPhoto(id, at) {
    const { commands, store } = this;
    const ids = store.selection.has(id) ? store.order.filter((one) => store.selection.has(one)) : [id];
    const one = ids.length === 1;
    const position = store.position(id);
    const { gps } = store.photos.get(id);
    const byGps = one && gps && store.satellite && Number.isFinite(gps.x_px) && isInside([gps.x_px, gps.y_px], store.satellite);
    if (one) store.setCurrent(id);
    const { canEdit } = store;
    openContextMenu(at, one ? store.photos.get(id).name : tn("{n} selected", "{n} selected", ids.length), [
      one && { icon: "fit", label: t("Full screen"), run: () => openViewer(commands) },
      one && position && { icon: "search", label: t("Show on the image"), run: () => this.view.reveal(position, { margin: 120 }) },
      ...(one && position ? this._placeItems(position) : []),
      one && { icon: "sort", label: t("Sort by distance from it"), run: () => this.order.sortBy("distance", id) },
      { icon: "check", label: store.selection.has(id) ? t("Unselect") : t("Select"), run: () => store.toggleSelected(id) },
      canEdit && byGps && !position && { icon: "target", label: t("Place by GPS"), run: () => commands.placeAt([id], [gps.x_px, gps.y_px]) },
      canEdit && ids.some((each) => store.photos.get(each)?.taken_at) && { icon: "clock", label: t("Time …"), run: () => timeDialog(commands, ids) },
      canEdit && !one && { icon: "compass", label: t("Heading …"), run: () => headingDialog(commands, ids) },
      canEdit && store.floors.length > 0 && ids.some((each) => store.isPlaced(each)) && { icon: "layers", label: t("To another floor …"), run: () => floorDialog(commands, ids) },
      canEdit && ids.some((each) => store.isPlaced(each)) && { icon: "tray", label: t("Back to the tray"), run: () => commands.toTray(ids) },
      canEdit && { icon: "trash", label: t("Remove"), danger: true, run: () => commands.remove(ids) },
    ]);
  }

  _ofImage(pixel, at) {
    const { commands, store } = this;
    if (!isInside(pixel, store.satellite)) return;
    const { current } = store;
    const words = current && (store.isPlaced(current.id) ? t("Move {name} here", { name: current.name }) : t("Place {name} here", { name: current.name }));
    openContextMenu(at, t("Satellite image"), [
      store.canEdit && current && { icon: "pin", label: words, run: () => commands.placeCurrent(pixel) },
      ...this._placeItems(pixel),
      store.canEdit && { icon: "note", label: t("Add a note here …"), run: () => this.notes.add(pixel) },
      { icon: "ruler", label: t("Measure from here"), run: () => this.measure.start(pixel) },
    ]);
  }

  /** Menu items for a position. */
  _placeItems(pixel) {
    const latLon = this.store.georeference.latLon(pixel);
    const [lat, lon] = latLon?.map((value) => value.toFixed(7)) ?? [];
    const text = latLon ? placeToCopy(latLon) : pixel.map(Math.round).join(", ");
    return [
      { icon: "copy", label: `${t("Copy the coordinates")} ${text}`, run: () => copy(text, t("Copied: {text}", { text })) },
      latLon && { icon: "map", label: t("Open in OpenStreetMap"), href: `https://www.openstreetmap.org/?mlat=${lat}&mlon=${lon}#map=19/${lat}/${lon}` },
    ].filter(Boolean);
  }
}
