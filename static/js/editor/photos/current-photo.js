/** The current photo, large, with its details and actions. */

import { byId, h, icon } from "../../shared/dom.js";
import { accuracyText, clockText, offText } from "../../shared/format.js";
import { t } from "../../shared/i18n.js";
import { onPositionForm, placeText } from "../../shared/map/positions.js";
import { creditLine } from "../../shared/photo-credit.js";
import { PanoramaView } from "../../shared/panorama-view.js";
import { PhotoZoom } from "../../shared/photo-zoom.js";
import { ProgressiveImage } from "../../shared/progressive-image.js";
import { rafThrottle } from "../../shared/timing.js";
import { WRITTEN } from "../../shared/written-facts.js";
import { blurPhotos } from "./blur-photos.js";
import { isWholeSphere, panoramaDialog } from "./panorama-dialog.js";
import { openViewer } from "./photo-viewer.js";

/** The panel of the current photo. */
export class CurrentPhoto {
  /**
   * @param {import("../commands.js").Commands} commands
   * @param {import("../../shared/map/map-view.js").MapView} view
   * @param {Object} server endpoints
   */
  constructor(commands, view, server) {
    this.commands = commands;
    this.view = view;
    this.server = server;
    this.store = commands.store;
    this.image = byId("current-image", HTMLImageElement);
    this.picture = new ProgressiveImage(byId("current-frame"), this.image);
    this.zoom = new PhotoZoom(byId("current-frame"), this.image);
    this.around = new PanoramaView(this.image);
    /** @type {Map<string, HTMLInputElement|HTMLTextAreaElement>} fields of the written texts, by name */
    this.written = new Map(WRITTEN.map(({ name }) => [name, /** @type {*} */ (byId(`current-${name}`))]));
    this.heading = byId("current-heading", HTMLInputElement);
    /** @type {?number} id of the photo that the fields show */
    this.shown = null;
    this._listen();
    const render = rafThrottle(() => this.render());
    this.store.on("current", () => {
      this._leave();
      this.zoom.reset();
      render();
    });
    this.store.on("photos placement satellite tool preview", render);
    onPositionForm(render);
    this.render();
  }

  _listen() {
    const { commands, store } = this;
    const on = (id, run) => byId(id).addEventListener("click", run);
    on("current-previous", () => commands.step(-1));
    on("current-next", () => commands.step(1));
    on("current-closer", () => (this.around.isShown ? this.around : this.zoom).step(1));
    on("current-farther", () => (this.around.isShown ? this.around : this.zoom).step(-1));
    on("current-whole", () => openViewer(commands));
    on("current-panorama", () => panoramaDialog(commands, this.server));
    this.around.addEventListener("look", () => this._look());
    on("current-show", () => this.view.reveal(store.position(store.currentId), { margin: 120 }));
    on("current-tray", () => commands.toTray([store.currentId]));
    on("current-blur", () => blurPhotos(store, this.server, [store.currentId]));
    on("selection-blur", () => blurPhotos(store, this.server, store.order.filter((id) => store.selection.has(id))));
    on("current-remove", () => commands.remove([store.currentId]));
    on("current-gps", () => commands.placeCurrent([store.current.gps.x_px, store.current.gps.y_px]));
    for (const [name, field] of this.written) field.addEventListener("change", () => commands.write(this.shown, name, field.value.trim()));
    this.heading.addEventListener("change", () => this._heading());
  }

  /** Show the viewing direction in the panorama on the dot. */
  _look() {
    const { around, store } = this;
    store.setLook(store.current?.panorama ? { id: store.currentId, turn: around.turn, fov: around.fov } : null);
  }

  _inside(photo) {
    const heading = photo ? this.store.heading(photo.id) : null;
    this.around.show(photo?.panorama && photo.preview ? { name: photo.name, src: photo.preview, heading } : null);
    if (photo?.id !== this.store.look?.id) this._look();
  }

  /** Commit the field being edited: a tap selects another photo before the field loses the focus. */
  _leave() {
    if (this.store.currentId === this.shown) return;
    [...this.written.values(), this.heading].find((field) => field === document.activeElement)?.blur();
  }

  _heading() {
    const input = this.heading;
    const degrees = input.value.trim() === "" ? null : Number(input.value.replace(",", "."));
    if (degrees === null || Math.abs(degrees) <= 360) this.commands.turn(this.shown, degrees);
    else {
      this.commands.warn(t("“{text}” is not a heading.", { text: input.value }), t("Give degrees clockwise from north, 0 to 360."));
      input.value = this._headingText(this.shown);
    }
  }

  _headingText(id) {
    const heading = this.store.heading(id);
    return heading === null ? "" : String(Math.round(heading));
  }

  render() {
    const { store } = this;
    const photo = store.current;
    byId("current-none").hidden = Boolean(photo);
    byId("current-some").hidden = !photo;
    this._instruction(photo);
    if (this.picture.show(photo)) this._ahead();
    this._inside(photo);
    if (!photo) return;
    const position = store.position(photo.id);
    byId("current-name").textContent = photo.name;
    byId("current-name").title = photo.name;
    byId("current-facts").replaceChildren(...this._facts(photo, position));
    this._buttons(photo, position);
    this.shown = photo.id;
    for (const [name, field] of this.written) {
      if (document.activeElement !== field) field.value = photo[name] ?? "";
    }
    if (document.activeElement !== this.heading) this.heading.value = this._headingText(photo.id);
  }

  /** Preload the next unplaced photo. */
  _ahead() {
    const waiting = this.store.unplaced();
    const next = waiting[waiting.indexOf(this.store.currentId) + 1];
    if (next !== undefined && this.store.isKnown(next)) new Image().src = this.store.photos.get(next).preview;
  }

  _facts(photo, position) {
    const fact = (name, ...text) => [h("dt", {}, name), h("dd", {}, ...text)];
    const facts = [];
    if (photo.taken_at) facts.push(...fact(t("Taken"), clockText(photo.taken_at)));
    if (photo.camera) facts.push(...fact(t("Camera"), photo.camera));
    facts.push(...fact(t("GPS"), this._gps(photo)));
    if (photo.file_notes?.length) facts.push(...fact(t("File"), photo.file_notes.join("; ")));
    if (position) {
      const radius = this.store.radius(photo.id);
      const within = radius === null ? "" : ` ±\u00a0${offText(radius, this.store.georeference.metresPerPixel)}`;
      const floor = this.store.floorNamed(this.store.floorOf(photo.id));
      if (floor) facts.push(...fact(t("Floor"), floor.name));
      facts.push(...fact(t("Placed at"), this.view.positionText(position) + within));
    }
    const written = this.store.canEdit ? [] : WRITTEN.filter(({ name }) => photo[name]);
    facts.push(...written.flatMap(({ name, label }) => fact(label, photo[name])));
    if (photo.source) facts.push(...fact(t("From"), creditLine(photo.source)));
    return facts;
  }

  _gps({ gps, gps_problem: problem }) {
    if (!gps) return h("span", { title: problem }, t("none")); // the reason is shown above the tray
    const accuracy = gps.accuracy_m ? ` ±\u00a0${accuracyText(gps.accuracy_m)}` : "";
    const { satellite } = this.store;
    const known = satellite && Number.isFinite(gps.x_px);
    const outside = known && (gps.x_px < 0 || gps.y_px < 0 || gps.x_px > satellite.width || gps.y_px > satellite.height);
    return placeText([gps.lat, gps.lon]) + accuracy + (outside ? ` (${t("outside the image")})` : "");
  }

  _buttons(photo, position) {
    const { store } = this;
    const { gps } = photo;
    const inside = store.satellite && gps && Number.isFinite(gps.x_px)
      && gps.x_px >= 0 && gps.y_px >= 0 && gps.x_px <= store.satellite.width && gps.y_px <= store.satellite.height;
    const there = position && inside && Math.hypot(position[0] - gps.x_px, position[1] - gps.y_px) < 0.5;
    byId("current-gps").hidden = !store.canEdit || !inside || Boolean(there);
    byId("current-show").hidden = !position;
    byId("current-tray").hidden = !store.canEdit || !position;
    byId("current-blur").hidden = !store.canEdit;
    byId("current-panorama").hidden = !store.canEdit || !isWholeSphere(photo);
    byId("current-remove").hidden = !store.canEdit;
    byId("current-turn").hidden = !store.canEdit;
    for (const { name } of WRITTEN) byId(`current-${name}-part`).hidden = !store.canEdit;
  }

  /** A line with the next step. */
  _instruction(photo) {
    const { store } = this;
    const left = store.unplaced().length;
    const state = !photo || !store.satellite || !store.canEdit ? "none" : store.tool;
    const words = {
      none: "",
      place: t("Click on the image where this photo was taken."),
      select: store.isPlaced(store.currentId) ? t("Drag its dot to move it, its arrow to turn it.") : t("Select the photo again to place it."),
    };
    const line = byId("instruction");
    line.hidden = !words[state];
    if (line.dataset.words === words[state]) return;
    line.dataset.words = words[state];
    line.replaceChildren(icon(state === "place" ? "target" : "pin"), words[state]);
    line.classList.toggle("is-placing", state === "place" && left > 0);
  }
}
