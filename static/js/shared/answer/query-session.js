/**
 * State of a query: the photo, its answer, the selected hypothesis, and what a click on the map means. Fires an
 * event named after what changed: `query`, `answer`, `chosen`, `mode`, `hint`, `spot`, `busy`, `live`.
 */

/** @typedef {Api["HypothesisOut"]} Hypothesis */

/** The server's verdict; answers that a browser has kept since an earlier version have none, and count as uncertain. */
export function verdictOf({ verdict, hypotheses }) {
  return verdict ?? (hypotheses.length ? "perhaps_place" : "off_map");
}

/** Whether an answer says "not on this map". */
export function isOffMap(answer) {
  return !["place", "perhaps_place"].includes(verdictOf(answer));
}

const LEAST_LISTED = 0.005;

/**
 * The order in which an answer is listed: places by probability, then all other places as one entry. "Not on this
 * map" comes before the less probable places, but after the other places if these are more probable.
 *
 * @returns {Array<{kind: "place"|"other"|"off", at: number}>} `at` is the index of a place
 */
export function ranking({ hypotheses, off_map_probability: off, other_probability: other }) {
  const entries = hypotheses.map((_, at) => ({ kind: "place", at }));
  const hasOther = other > LEAST_LISTED;
  if (hasOther) entries.push({ kind: "other", at: -1 });
  if (off === null) return entries;
  const lower = hypotheses.findIndex(({ probability }) => probability < off);
  const behind = lower < 0 || (hasOther && other > off);
  entries.splice(behind ? entries.length : lower, 0, { kind: "off", at: -1 });
  return entries;
}

/** State of one page view. */
export class QuerySession extends EventTarget {
  constructor() {
    super();
    this.query = null;
    this.answer = null;
    this.chosen = null;
    this.mode = "look";
    this.hint = null;
    this.spot = null;
    this.busy = false;
    this.live = false;
  }

  emit(name) {
    this.dispatchEvent(new Event(name));
  }

  /** Call a function on some events. */
  on(names, run) {
    for (const name of names.split(" ")) this.addEventListener(name, run);
  }

  /** The selected hypothesis. @returns {?Hypothesis} */
  get hypothesis() {
    return this.answer?.hypotheses.find(({ rank }) => rank === this.chosen) || null;
  }

  /** Where the photo was taken: the position set by hand, else that of the selected hypothesis. */
  get position() {
    if (this.spot) return this.spot;
    const found = this.hypothesis;
    return found && [found.x_px, found.y_px];
  }

  /**
   * Show a photo.
   * @param {?Object} query `name`, and `preview` or a local `url`; with an `id` once the server has stored it
   */
  setQuery(query) {
    if (this.query?.url && this.query.url !== query?.url) URL.revokeObjectURL(this.query.url);
    this.query = query;
    this.emit("query");
  }

  /** Show an answer; null while there is none. */
  setAnswer(answer) {
    this.answer = answer;
    this.spot = null;
    this.chosen = answer && !isOffMap(answer) ? answer.hypotheses[0].rank : null;
    if (this.mode === "correct") this.setMode("look");
    this.emit("answer");
    this.emit("chosen");
  }

  /** Select a hypothesis. @param {?number} rank */
  choose(rank) {
    if (this.spot) {
      this.spot = null;
      this.emit("spot");
    }
    this.chosen = rank;
    this.emit("chosen");
  }

  /** @param {"look"|"hint"|"correct"} mode what a click on the map means */
  setMode(mode) {
    this.mode = mode;
    this.emit("mode");
  }

  /** @param {?{x_px: number, y_px: number, radius_px: number}} hint */
  setHint(hint) {
    this.hint = hint;
    this.emit("hint");
  }

  /** Set by hand where the photo was taken. @param {?[number, number]} spot map pixels */
  setSpot(spot) {
    this.spot = spot;
    this.emit("spot");
  }

  setBusy(busy) {
    this.busy = busy;
    this.emit("busy");
  }

  setLive(live) {
    this.live = live;
    this.emit("live");
  }
}
