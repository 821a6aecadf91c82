/** Sends photos, waits for an index that is being built, and shows the answers. */

import { verdictText } from "../shared/answer/verdict.js";
import { WaitingWords } from "../shared/answer/waiting-words.js";
import { openDialog } from "../shared/dialogs.js";
import { byId, h, icon } from "../shared/dom.js";
import { usable } from "../shared/drop-files.js";
import { leftText } from "../shared/format.js";
import { labelled, t, tn } from "../shared/i18n.js";
import { queuedText } from "../shared/job-list.js";
import { note, sentence, toast } from "../shared/toast.js";

const MOST_OF_ONE_SPOT = 8;
/** Below this probability of the first place, more photos are suggested. */
const SURE = 0.8;

/** Sends one query at a time; a newer one cancels it. */
export class Localizer extends EventTarget {
  /**
   * @param {{session: import("../shared/answer/query-session.js").QuerySession, store: import("../shared/map/map-store.js").MapStore, server: Object,
   *   options: import("./options.js").Options, say: function(string): void}} page
   */
  constructor(page) {
    super();
    this.session = page.session;
    this.store = page.store;
    this.server = page.server;
    this.options = page.options;
    this.say = page.say;
    this.waiting = null;
    this._abort = null;
    this.words = new WaitingWords(byId("busy-words"), byId("busy", HTMLProgressElement));
    this.session.on("busy", () => !this.session.busy && this.words.end());
    this.store.on("jobs", () => this._jobs());
    this.session.on("answer", () => {
      byId("further").replaceChildren();
      this._adviseOwner(this.session.answer);
    });
  }

  /** Localize photos that were chosen, dropped or pasted. @param {File[]} files */
  async take(files) {
    if (!files.length) return;
    const together = files.length === 1 || (await this._together(files.length));
    if (together === null) return;
    if (together) {
      await this.ask(files);
      return;
    }
    this.dispatchEvent(new CustomEvent("separately", { detail: files }));
  }

  /** @param {File[]} files of one spot @returns {Promise<boolean>} whether there is an answer */
  ask(files) {
    const { session } = this;
    session.setQuery({ name: files.map(({ name }) => name).join(", "), url: URL.createObjectURL(files[0]), files });
    return this._run((on) => this.server.ask(files, this.options.values(), on));
  }

  /** Localize the same photo with the present options. */
  again() {
    const { query } = this.session;
    if (this.waiting) return this._run(this.waiting);
    if (query?.files?.length > 1) return this.ask(query.files);
    if (query?.id) return this._run((on) => this.server.askAgain(query.id, this.options.values(), on));
    return null;
  }

  /** Show an earlier answer. @param {number} id */
  async open(id) {
    this._abort?.abort();
    this.waiting = null;
    try {
      this._show(await this.server.query(id));
    } catch (error) {
      this._problem(error);
    }
  }

  /** Cancel a pending query. */
  cancel() {
    this._abort?.abort();
    this.waiting = null;
    this.session.setBusy(false);
    byId("notes").replaceChildren();
  }

  /** Localize again with more photos from the same spot. @param {File[]} files */
  async _add(files) {
    const { session } = this;
    const { query, answer } = session;
    if (!files.length) return;
    let first = query.files;
    try {
      first ||= [new File([await this.server.photo(query.id)], query.name)];
    } catch (error) {
      this._problem(error);
      return;
    }
    if (session.query !== query) return; // another query was sent meanwhile
    const all = [...first, ...files];
    if (all.length > MOST_OF_ONE_SPOT) toast(tn("At most {n} photo from one spot is used.", "At most {n} photos from one spot are used.", MOST_OF_ONE_SPOT));
    const asked = this.ask(all.slice(0, MOST_OF_ONE_SPOT));
    const ours = session.query;
    if ((await asked) || this.waiting || session.query !== ours) return;
    session.setQuery(query); // failed: restore the previous answer
    session.setAnswer(answer);
    history.replaceState(null, "", `?query=${query.id}`);
    this._offerMore(answer);
  }

  async _run(send) {
    this._abort?.abort();
    const abort = new AbortController();
    this._abort = abort;
    this.waiting = null;
    this.session.setBusy(true);
    this.words.begin(Boolean(this.session.query.files));
    byId("query-frame").scrollIntoView({ block: "nearest" }); // in a low window it is below the map
    this.session.setAnswer(null);
    byId("notes").replaceChildren();
    history.replaceState(null, "", location.pathname);
    try {
      const { files } = this.session.query;
      const answer = await send(this._listeners(abort.signal));
      if (abort.signal.aborted) return false;
      this._show({ ...(await this.server.query(answer.id)), files }, answer);
      this.dispatchEvent(new Event("asked"));
      return true;
    } catch (error) {
      if (!abort.signal.aborted && error.name !== "AbortError") this._failed(error, send);
      return false;
    } finally {
      if (this._abort === abort) this.session.setBusy(Boolean(this.waiting));
    }
  }

  /** What a request reports to. @param {AbortSignal} signal */
  _listeners(signal) {
    return {
      signal,
      onProgress: (sent, all) => this.words.sent(sent, all),
      onEvent: (kind, data) => {
        if (signal.aborted) return;
        this.words.take(kind, data);
        if (kind === "first") this._showFirst(data);
      },
    };
  }

  /** Show the answer of the first look while the second one is taken. */
  _showFirst(answer) {
    this.session.setAnswer(answer);
    byId("further").replaceChildren();
    this.say(verdictText(answer));
  }

  _show(query, answer = query.answer) {
    byId("notes").replaceChildren();
    this.session.setQuery(query);
    this.session.setAnswer(answer);
    history.replaceState(null, "", `?query=${query.id}`);
    this._notes(answer);
    this.say(verdictText(answer));
  }

  /** Show notes on limits of the answer. */
  _notes(answer) {
    const notes = [];
    if (answer.calibrated === false) notes.push(t("The probabilities are those of a typical map: the calibration of this map is still running."));
    if (answer.not_indexed) notes.push(tn("{n} new photo of the map is not indexed yet.", "{n} new photos of the map are not indexed yet.", answer.not_indexed));
    for (const text of notes) byId("notes").append(note("info", text));
    this._offerMore(answer);
  }

  /** Show the line about missing models, which only the page of the library's owner has. */
  _adviseOwner(answer) {
    const advice = document.getElementById("second-look-missing");
    if (advice) advice.hidden = !answer || isSure(answer);
  }

  /** Offer ways to a more certain answer. */
  _offerMore(answer) {
    const { files, options } = this.session.query;
    const photos = files?.length || options.photos;
    const whole = Boolean(files) || photos === 1; // of several photos, the server keeps only one
    const buttons = [];
    if (whole && photos < MOST_OF_ONE_SPOT) buttons.push(chooseMore((chosen) => this._add(chosen)));
    if (whole && ["auto", "verified"].includes(answer.method) && this.options.offers("method", "thorough")) {
      buttons.push(lookCloser(() => {
        this.options.set("method", "thorough");
        this.options.set("features", "auto");
        this.again();
      }));
    }
    if (isSure(answer) || !buttons.length) return;
    const text = t("More photos from the same spot, in other directions, make the answer more certain.");
    byId("further").replaceChildren(note("info", text), h("div", { class: "lo-more" }, ...buttons));
  }

  _failed(error, send) {
    if (error.code === "not_ready") {
      this.waiting = send;
      this.oldFailures = new Set(this.store.jobs.filter(({ state }) => state === "failed").map(({ id }) => id));
      this._building();
      return;
    }
    this._problem(error);
  }

  _problem({ message, hint, where }) {
    const oneOfSeveral = this.session.query?.files?.length > 1 && where;
    const text = oneOfSeveral ? labelled(where, message) : sentence(message);
    byId("notes").replaceChildren(note("danger", text, hint && sentence(hint)));
  }

  _building() {
    this.words.waitForIndex();
    const job = this._indexJob();
    const text = t("The photo is localized as soon as the map is indexed.");
    byId("notes").replaceChildren(note("info", text, job?.state === "queued" ? queuedText(job) : null, indexBar(job)));
  }

  _indexJob() {
    return this.store.jobs.find(({ kind, state }) => kind === "index" && (state === "running" || state === "queued"));
  }

  /** Show the progress of indexing before the first query. */
  _indexing() {
    const job = this._indexJob();
    byId("soon").hidden = Boolean(job);
    byId("indexing").hidden = !job;
    byId("indexing").replaceChildren(...(job ? [h("div", {}, indexWords(job)), indexBar(job)] : []));
  }

  /** Send a waiting query once the index is ready. */
  _jobs() {
    this._indexing();
    if (!this.waiting) return;
    const jobs = this.store.jobs.filter(({ kind }) => kind === "index");
    const failed = jobs.at(-1)?.state === "failed" && !this.oldFailures.has(jobs.at(-1).id) && jobs.at(-1);
    if (jobs.some(({ state }) => state === "running" || state === "queued")) this._building();
    else if (failed) {
      this.waiting = null;
      this.session.setBusy(false);
      this._problem(failed.error);
    } else this._run(this.waiting);
  }

  /** Ask whether several photos are of one spot. @returns {Promise<?boolean>} null if the dialog is closed */
  _together(count) {
    return new Promise((resolve) => {
      let answer = null;
      const button = (label, value, kind) =>
        h("button", { class: `button ${kind}`, type: "button", autofocus: !value, onclick: () => ((answer = value), dialog.close()) }, label);
      const actions = [button(t("Each separately"), false, "button--primary")];
      if (count <= MOST_OF_ONE_SPOT) actions.unshift(button(t("All from the same spot"), true, ""));
      const text = t("Photos taken from one spot in several directions are localized together.");
      const dialog = openDialog(tn("{n} photo", "{n} photos", count), [h("p", { class: "soft" }, text)], { actions });
      dialog.addEventListener("close", () => resolve(answer));
    });
  }
}

function indexWords(job) {
  if (job.state === "queued") return [t("The map is not indexed yet."), queuedText(job)].join(" ");
  const left = job.seconds_left === null ? "" : leftText(job.seconds_left);
  return [t("The map is being indexed."), left].filter(Boolean).join(" · ");
}

function indexBar(job) {
  const bar = h("progress", { class: "progress", max: 1, "aria-label": t("Indexing progress") });
  if (job?.total) bar.value = job.done / job.total;
  return bar;
}

/** Whether an answer is certain enough; `vote` has no probabilities to judge by. */
function isSure({ method, hypotheses: [first], off_map_probability: off }) {
  return method === "vote" || Math.max(first?.probability ?? 0, off) >= SURE;
}

function lookCloser(run) {
  return h("button", { class: "button", type: "button", "data-testid": "look-closer", onclick: run }, icon("target"), t("Compare thoroughly"));
}

function chooseMore(take) {
  const input = h("input", {
    class: "ed-file", id: "more-input", type: "file", multiple: true, accept: byId("query-input", HTMLInputElement).accept,
    "data-testid": "more-input", onchange: () => take(usable(input.files)),
  });
  return h("span", {}, input, h("label", { class: "button", for: "more-input" }, icon("image"), t("Add photos from this spot")));
}
