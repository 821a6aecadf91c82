/** The query next to a photo of the map that supports the chosen place; small in the panel, large in a dialog. */

import { openDialog } from "../shared/dialogs.js";
import { byId, h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { PanoramaView } from "../shared/panorama-view.js";
import { creditLine } from "../shared/photo-credit.js";
import { term } from "../shared/term.js";
import { matchView } from "./match-view.js";

const ROOM_IN_PANEL = 0.85;

/** Shows matches of the present answer. */
export class MatchPanel {
  /** @param {{session: import("../shared/answer/query-session.js").QuerySession, store: import("../shared/map/map-store.js").MapStore, server: Object}} page */
  constructor({ session, store, server }) {
    this.session = session;
    this.store = store;
    this.server = server;
    this.of = null;
    this.known = [];
    this.select = byId("matches-photo", HTMLSelectElement);
    this.around = new PanoramaView(byId("matches-inside", HTMLImageElement));
    session.on("answer query", () => this._load());
    session.on("chosen", () => this._choices());
    store.on("photos", () => this._incomplete && this._choices());
    this.select.addEventListener("change", () => this._show());
    byId("matches-all", HTMLInputElement).addEventListener("change", () => this._show());
    byId("matches-large").addEventListener("click", () => this._large());
  }

  async _load() {
    const id = this.session.answer ? this.session.query?.id : null;
    if (!id) {
      this.of = null;
      this.known = [];
      return this._choices();
    }
    if (id === this.of) return;
    this.of = id;
    this.known = [];
    this._choices();
    try {
      const { matches } = await this.server.matches(id);
      if (this.of === id) this.known = matches;
    } catch {
      if (this.of === id) this.of = null;
    }
    this._choices();
  }

  /** List the photos that support the chosen place and whose matches are loaded. */
  _choices() {
    const speaking = new Set(this.session.hypothesis?.experiences || []);
    const there = this.known.filter(({ experience }) => speaking.has(experience) && this.store.photos.has(experience));
    const some = there.filter(({ experience }) => this.store.isKnown(experience));
    this._incomplete = some.length < there.length;
    byId("matches").hidden = !some.length;
    const name = ({ experience }) => this.store.photos.get(experience).name;
    this.select.replaceChildren(...some.map((match) => h("option", { value: match.experience }, name(match))));
    this._show();
  }

  get _pair() {
    const match = this.known.find(({ experience }) => experience === Number(this.select.value));
    const { query } = this.session;
    const photo = match && this.store.photos.get(match.experience);
    if (!photo || !query?.id) return null;
    return {
      query: { src: query.preview, name: query.name, width: query.width, height: query.height },
      photo: { src: photo.preview, name: photo.name, width: photo.width, height: photo.height },
      lines: match,
      inside: photo.panorama ? { name: photo.name, src: photo.preview, heading: this.store.heading(photo.id) } : null,
      credit: photo.source ? creditLine(photo.source) : null,
    };
  }

  _show() {
    const pair = this._pair;
    const view = byId("matches-view");
    view.replaceChildren(...(pair ? [matchView(pair, { all: this._all, shape: ROOM_IN_PANEL })] : []));
    byId("matches-around").hidden = !pair?.inside;
    this.around.show(pair?.inside ?? null, pair?.inside ? middleOf(pair.lines, pair.photo.width) : 0);
    byId("matches-count").replaceChildren(...(pair ? [...count(pair.lines), ...behind(pair.credit)] : []));
  }

  get _all() {
    return byId("matches-all", HTMLInputElement).checked;
  }

  _large() {
    const pair = this._pair;
    if (!pair) return;
    const shape = innerWidth / innerHeight;
    const dialog = openDialog(t("{query} and {photo}", { query: pair.query.name, photo: pair.photo.name }), [
      matchView(pair, { all: this._all, shape }),
      h("p", { class: "small soft" }, ...count(pair.lines), ...behind(pair.credit), " · ", t("Zoom by wheel, pinch or double-click.")),
    ]);
    dialog.classList.add("lo-dialog");
  }
}

/** Mean direction of the inliers in a panorama, degrees clockwise from its middle. */
function middleOf({ photo_xy: points, inlier }, width) {
  const some = inlier.some(Boolean) ? points.filter((_, n) => inlier[n]) : points;
  const angles = some.map(([x]) => (2 * Math.PI * x) / width);
  const sum = (part) => angles.reduce((all, angle) => all + part(angle), 0);
  return (Math.atan2(sum(Math.sin), sum(Math.cos)) * 180) / Math.PI - 180;
}

const behind = (part) => (part ? [" · ", part] : []);

function count({ inlier }) {
  const inliers = inlier.filter(Boolean).length;
  return [t("{inliers} matching points, of {n} compared", { inliers, n: inlier.length }), " ", term("inliers")];
}
