/** An image from a tile service: area, zoom, an estimate, and the job that fetches it. */

import { get, post } from "../shared/api.js";
import { busy } from "../shared/dialogs.js";
import { byId, h, icon, queryAll } from "../shared/dom.js";
import { metresText } from "../shared/format.js";
import { duration, locale, t, tn } from "../shared/i18n.js";
import { failureNote, isDismissed } from "../shared/job-failure.js";
import { queuedText } from "../shared/job-list.js";
import { toastError } from "../shared/toast.js";
import { cut } from "./mercator.js";
import { outsideChoices } from "./outside-photos.js";
import { base, movedPhotoNotes, note, page, toEditor } from "./page.js";
import { placeSearch } from "./place-search.js";
import { Rectangle } from "./rectangle.js";
import { goHere, goTo, slippyMap } from "./tile-map.js";

const EDGES = ["north", "south", "west", "east"];
const GOOD_SIDE_PX = 2000;
const ASK_MS = 700;
const DOT = { radius: 4, className: "sat-photo", interactive: false };

/** The panel; its map is created when it is first shown. */
export class TilesPanel {
  /**
   * @param {{asked: boolean, blank: function(): void}} options `asked`: whether tiles may be requested as soon as the
   *   panel opens; `blank` shows the panel of a blank plan instead
   */
  constructor({ asked, blank }) {
    this.asked = asked;
    this.blank = blank;
    this.form = byId("way-tiles");
    this.zoom = byId("tile-zoom", HTMLInputElement);
    this.slippy = null;
    this.job = null;
    this._goTo();
    if (page.failure && !isDismissed(page.failure.id)) byId("notes").after(this._offerBlank(failureNote(page.failure)));
    goHere(byId("tile-here"), () => this.slippy?.map);
    byId("tile-service").addEventListener("change", () => this._service());
    byId("tile-view").addEventListener("click", () => this.rectangle.ofView());
    byId("tile-cancel").addEventListener("click", (event) => this._cancel(event.currentTarget));
    this.zoom.addEventListener("input", () => this._estimate());
    for (const edge of EDGES) byId(`tile-${edge}`, HTMLInputElement).addEventListener("change", () => this._written());
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      busy(event.submitter, () => this._fetch()).catch(toastError);
    });
  }

  /** Show the map, and the area around the photos if there are any. */
  open() {
    if (this.slippy) return;
    const load = this.asked ? null : byId("tile-load", HTMLButtonElement);
    this.slippy = slippyMap(byId("tile-map"), byId("tile-service"), { load });
    L.control.scale({ imperial: false }).addTo(this.slippy.map);
    for (const place of page.photos?.positions || []) L.circleMarker(place, DOT).addTo(this.slippy.map);
    this.rectangle = new Rectangle(this.slippy.map, (box) => this._write(box));
    this._service();
    if (page.earth) this.rectangle.ofView();
    else if (page.photos) this.rectangle.propose(page.photos);
    if (this.rectangle.box) this._goodZoom();
    this._estimate();
    this._resume();
  }

  _goTo() {
    const map = () => this.slippy?.map;
    const go = goTo(byId("tile-goto"), map, page.geocoder ? placeSearch(byId("tile-places"), map) : null);
    if (page.geocoder) byId("tile-search").addEventListener("click", go);
  }

  _service() {
    const { max_zoom } = this.slippy.service();
    this.zoom.max = max_zoom;
    this.zoom.value = String(Math.min(this.zoom.valueAsNumber, max_zoom));
    this._estimate();
  }

  /** Choose the zoom at which the image has a good size. */
  _goodZoom() {
    const { max_tiles } = this.slippy.service();
    for (let zoom = Number(this.zoom.max); zoom > 0; zoom -= 1) {
      const { width, height, tiles } = cut(this.rectangle.box, zoom);
      this.zoom.value = String(zoom);
      if (Math.max(width, height) <= GOOD_SIDE_PX && tiles <= max_tiles) return;
    }
  }

  /** The rectangle was changed on the map. */
  _write(box) {
    const first = !byId("tile-north", HTMLInputElement).value;
    for (const edge of EDGES) byId(`tile-${edge}`, HTMLInputElement).value = box[edge];
    if (first) this._goodZoom();
    this._estimate();
  }

  /** The edges were changed in the fields. */
  _written() {
    const box = Object.fromEntries(EDGES.map((edge) => [edge, byId(`tile-${edge}`, HTMLInputElement).valueAsNumber]));
    const whole = Object.values(box).every(Number.isFinite) && box.north > box.south && box.west !== box.east;
    this.rectangle.show(whole ? box : null);
    if (whole) this.slippy.map.fitBounds(this.rectangle.shape.getBounds().pad(0.2));
    this._estimate();
  }

  _estimate() {
    const zoom = this.zoom.valueAsNumber;
    byId("tile-zoom-value").textContent = String(zoom);
    const { box } = this.rectangle || {};
    const [button] = queryAll("[type=submit]", HTMLButtonElement, this.form);
    const place = byId("tile-estimate");
    place.classList.remove("sat-estimate--bad");
    button.disabled = !box;
    if (!box) {
      place.textContent = t("Move the map to the right place, then select the visible area.");
      return;
    }
    const { width, height, tiles, metresPerPixel } = cut(box, zoom);
    const { max_tiles } = this.slippy.service();
    const size = t("{width} × {height} pixels", { width: number(width), height: number(height) });
    const parts = [size, t("{metres} m per pixel", { metres: metresText(metresPerPixel) }), tn("{n} piece to download", "{n} pieces to download", tiles)];
    if (tiles > max_tiles) {
      parts.push(tn("only {n} piece is allowed: smaller area or zoom", "only {n} pieces are allowed: smaller area or zoom", max_tiles));
      place.classList.add("sat-estimate--bad");
      button.disabled = true;
    }
    place.textContent = parts.join(" · ");
  }

  async _fetch() {
    const wish = { service: this.slippy.service().name, zoom: this.zoom.valueAsNumber, ...this.rectangle.box };
    await this._queue(wish);
  }

  async _queue(wish) {
    const { job } = await post(`${base}/satellite/tiles`, wish);
    const ended = await this._watch(job);
    if (ended.state === "done") {
      const { width, height, from_tray, to_tray, warnings } = ended.result;
      const text = t("The image has {width} × {height} pixels.", { width: number(width), height: number(height) });
      toEditor([{ kind: "success", text }, ...movedPhotoNotes(from_tray, to_tray), ...warnings.map((w) => ({ kind: "warning", text: w }))]);
    } else if (ended.state === "failed") {
      const choice = await outsideChoices(ended.error);
      if (choice) await this._queue({ ...wish, ...choice });
      else byId("tile-progress").after(this._problem(ended.error));
    }
  }

  _problem({ message, hint }) {
    return this._offerBlank(note("danger", message, hint));
  }

  /** Offer a blank plan, which needs no network, in an error message. @param {HTMLElement} shown */
  _offerBlank(shown) {
    const button = h("button", { class: "button", type: "button", onclick: this.blank }, icon("image"), t("Blank plan"));
    shown.querySelector(":scope > div").append(h("div", { class: "row" }, t("A blank plan needs no network:"), button));
    return shown;
  }

  /** Follow a running job that fetches tiles for this map. */
  async _resume() {
    const { jobs } = await get(`/jobs?map=${encodeURIComponent(page.slug)}`);
    const live = jobs.find(({ kind, state }) => kind === "satellite-tiles" && (state === "queued" || state === "running"));
    if (live && (await this._watch(live.id)).state === "done") toEditor([{ kind: "success", text: t("The image is in place.") }]);
  }

  async _watch(id) {
    const box = byId("tile-progress");
    this.form.querySelectorAll(":scope > .note").forEach((old) => old.remove());
    document.querySelector("[data-job-failure]")?.remove();
    this.job = id;
    box.hidden = false;
    try {
      for (;;) {
        const job = await get(`/jobs/${id}`);
        this._progress(box, job);
        if (!["queued", "running"].includes(job.state)) return job;
        await new Promise((resolve) => setTimeout(resolve, ASK_MS));
      }
    } finally {
      box.hidden = true;
      this.job = null;
    }
  }

  _progress(box, job) {
    const { state, done, total, seconds_left: left } = job;
    const bar = box.querySelector("progress");
    if (state === "running" && total) Object.assign(bar, { max: total, value: done });
    else bar.removeAttribute("value");
    const words = [state === "queued" ? queuedText(job) : t("{done} of {total} pieces of the image", { done: number(done), total: number(total) })];
    if (left) words.push(t("about {time} left", { time: duration(left) }));
    box.querySelector("[data-part=words]").textContent = words.join(" · ");
  }

  _cancel(button) {
    if (this.job) busy(button, () => post(`/jobs/${this.job}/cancel`)).catch(toastError);
  }
}

const number = (value) => value.toLocaleString(locale);
