/** Localizes many photos separately: a table of the answers, and all of them on the map. */

import { answerBadge } from "../shared/answer/answer-badge.js";
import { probabilityColours } from "../shared/answer/answer-format.js";
import { isOffMap } from "../shared/answer/query-session.js";
import { byId, h, icon } from "../shared/dom.js";
import { lengthText, percentText } from "../shared/format.js";
import { labelled, t } from "../shared/i18n.js";
import { latLngOf } from "../shared/map/coords.js";
import { BASE_FLOOR } from "../shared/map/map-store.js";
import { printDialog } from "../shared/print-dialog.js";
import { sentence } from "../shared/toast.js";

const INDEXING_MS = 3000;
const RADIUS_PX = 9;

/** The tab *Several*, hidden until several photos were chosen. */
export class Batch {
  /**
   * @param {Object} page server, store, options, slug
   * @param {import("../shared/map/map-view.js").MapView} view
   * @param {{show: function(): void, open: function(number): void}} tab `show` this tab; `open` an answer
   */
  constructor({ server, store, options, slug }, view, { show, open }) {
    this.server = server;
    this.options = options;
    this.base = `/api/v1/maps/${encodeURIComponent(slug)}/queries/answers`;
    this.store = store;
    this.view = view;
    this.show = show;
    this.open = open;
    this.marks = L.layerGroup();
    /** @type {Array<{mark: L.CircleMarker, floor: number}>} */
    this._places = [];
    store.on("floor", () => this._showFloor());
    this.ids = [];
    /** Whether an answer has a latitude and longitude, which all downloads but the table need. */
    this.onEarth = false;
    byId("batch-stop").addEventListener("click", () => this.stop());
    byId("batch-print").addEventListener("click", () => printDialog(store, this._range()));
  }

  /** Localize one photo after the other. @param {File[]} files */
  async run(files) {
    this.stop();
    const abort = (this._abort = new AbortController());
    this.ids = [];
    this._places = [];
    this.marks.clearLayers();
    byId("tab-batch").hidden = false;
    byId("batch-stop").hidden = false;
    this.show();
    const rows = files.map((file) => new Row(file, this.open));
    byId("batch-rows").replaceChildren(...rows.map(({ element }) => element));
    for (const [n, file] of files.entries()) {
      this._progress(n, files.length);
      rows[n].say(t("..."));
      await this._one(rows[n], file, abort.signal);
      if (abort.signal.aborted) break;
    }
    if (this._abort !== abort) return;
    this._progress(this.ids.length, files.length);
    byId("batch-stop").hidden = true;
  }

  stop() {
    this._abort?.abort();
    byId("batch-stop").hidden = true;
  }

  /** Show or hide the answers on the map. @param {boolean} seen whether their table is shown */
  showMarks(seen) {
    if (seen) this.marks.addTo(this.view.map);
    else this.marks.remove();
  }

  async _one(row, file, signal) {
    try {
      const answer = await this._ask(row, file, signal);
      this.ids.push(answer.id);
      this.onEarth ||= answer.hypotheses.some(({ lat }) => lat !== null);
      row.answer(answer);
      this._mark(row, answer);
      this._downloads();
    } catch (error) {
      row.say(error.name === "AbortError" ? t("not asked") : sentence(error.message));
    }
  }

  /** Localize a photo; retry while the map is being indexed. */
  async _ask(row, file, signal) {
    for (;;) {
      try {
        return await this.server.ask([file], this.options.values(), { signal });
      } catch (error) {
        if (error.code !== "not_ready") throw error;
        row.say(t("The map is being indexed."));
        await new Promise((resolve) => setTimeout(resolve, INDEXING_MS));
        signal.throwIfAborted();
      }
    }
  }

  _mark(row, answer) {
    if (isOffMap(answer)) return;
    const [{ x_px: x, y_px: y, probability, floor = BASE_FLOOR }] = answer.hypotheses;
    const { fill } = probabilityColours(probability);
    const mark = L.circleMarker(latLngOf([x, y]), { radius: RADIUS_PX, color: "#fff", weight: 2, fillColor: fill, fillOpacity: 1 });
    mark.bindTooltip(labelled(row.name, percentText(probability)));
    mark.on("click", () => this.open(answer.id));
    this._places.push({ mark, floor });
    this._showFloor();
  }

  /** Show only the answers on the shown floor. */
  _showFloor() {
    this.marks.clearLayers();
    for (const { mark, floor } of this._places) if (!this.store.floors.length || floor === this.store.floor) this.marks.addLayer(mark);
  }

  _progress(done, all) {
    byId("batch-count").textContent = t("{done} of {all} localized", { done, all });
  }

  /** Range of the answers' ids. */
  _range() {
    return { first: Math.min(...this.ids), last: Math.max(...this.ids) };
  }

  _downloads() {
    const { first, last } = this._range();
    const range = new URLSearchParams({ first: String(first), last: String(last), mine: "true" });
    byId("batch-downloads").hidden = false;
    for (const link of byId("batch-downloads").querySelectorAll("a")) {
      link.href = `${this.base}.${link.dataset.form}?${range}`;
      link.hidden = link.dataset.form !== "csv" && !this.onEarth;
    }
  }
}

/** A row of the table. */
class Row {
  constructor(file, open) {
    this.name = file.name;
    this.open = open;
    this.state = h("td", { colspan: 2, class: "soft" }, t("waiting"));
    const image = h("img", { class: "ed-thumb", src: URL.createObjectURL(file), alt: "" });
    image.addEventListener("error", () => image.replaceWith(h("span", { class: "ed-thumb lo-batch__none" }, icon("image")))); // HEIC, PDF
    this.element = h("tr", { "data-testid": "batch-row" }, h("td", {}, image), h("th", { scope: "row", title: file.name }, file.name), this.state);
  }

  say(text) {
    this.state.textContent = text;
  }

  answer(answer) {
    const button = h("button", { class: "lo-batch__name", type: "button", onclick: () => this.open(answer.id) }, this.name);
    this.element.children[1].replaceChildren(button);
    this.state.replaceWith(h("td", { class: "small" }, isOffMap(answer) ? "" : where(answer.hypotheses[0])), h("td", {}, answerBadge(answer)));
  }
}

function where({ floor_name: floor, radius_m: m, radius_px: px, heading_deg: heading }) {
  return [floor, px === null ? t("Area") : `± ${lengthText(m, px)}`, heading === null ? "" : `${Math.round(heading)}°`].filter(Boolean).join(" · ");
}
