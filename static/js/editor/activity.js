/** Current activity, in a corner of the image: uploads, and jobs of the server. */

import { byId, h, icon, queryAll } from "../shared/dom.js";
import { leftText } from "../shared/format.js";
import { t, tn } from "../shared/i18n.js";
import { dismiss, isDismissed } from "../shared/job-failure.js";
import { queuedText, REASONS } from "../shared/job-list.js";
import { isInside } from "../shared/map/coords.js";
import { rafThrottle } from "../shared/timing.js";
import { sentence, toastError } from "../shared/toast.js";
import { canGoAgain } from "../shared/uploads.js";
import { imageOffers } from "./image-offer.js";

const JOBS = {
  blur: () => t("Finding faces and number plates"),
  index: () => t("Indexing the photos"),
  evaluate: () => t("Evaluating the map"),
  health: () => t("Finding places that look similar"),
  landmarks: () => t("Computing landmarks"),
  "photo-pieces": () => t("Checking which photos join"),
  "place-rest": () => t("Finding places for the rest"),
  "mission-fuse": () => t("The track is being corrected"),
  sample: () => t("Creating the sample map"),
  "satellite-pyramid": () => t("Preparing the image for display"),
  "satellite-tiles": () => t("Fetching the satellite image"),
  "street-photos": () => t("Adding street-level photos"),
  "video-photos": () => t("Adding photos of a video"),
  import: () => t("Importing"),
  export: () => t("Exporting"),
};
const FAILURES_SHOWN = 100;

/** The card of uploads and jobs; hidden when there is nothing to show. */
export class Activity {
  /**
   * @param {import("../shared/map/map-store.js").MapStore} store
   * @param {import("../shared/uploads.js").Uploads} uploads
   * @param {{server: Object, refresh: function(): Promise<void>, say: function(string): void}} page
   */
  constructor(store, uploads, { server, refresh, say }) {
    this.store = store;
    this.uploads = uploads;
    this.server = server;
    this.refresh = refresh;
    this.say = say;
    this.filesBox = h("div", { class: "ed-files", hidden: true });
    this.jobsBox = h("div", { class: "ed-jobs" });
    byId("activity").append(foldButton(byId("activity")), this.filesBox, this.jobsBox);
    const files = rafThrottle(() => this._files());
    uploads.addEventListener("progress", files);
    uploads.addEventListener("finished", async () => {
      await this.refresh().catch(() => {});
      this.say(this._summary().join(" "));
    });
    store.on("photos", files);
    store.on("jobs", () => this._jobs());
  }

  _frame() {
    byId("activity").hidden = this.filesBox.hidden && !this.jobsBox.children.length;
  }

  _files() {
    const { entries, busy } = this.uploads;
    this.filesBox.hidden = !entries.length;
    if (entries.length) this.filesBox.replaceChildren(...(busy ? this._sending(entries) : this._sent()));
    this._frame();
  }

  _sending(entries) {
    const ended = entries.filter(({ state }) => state !== "waiting" && state !== "sending").length;
    const all = entries.reduce((sum, { file }) => sum + file.size, 0);
    const sent = entries.reduce((sum, { sent: bytes, state, file }) => sum + (state === "failed" ? file.size : bytes), 0);
    const seconds = (performance.now() - this.uploads.begunAt) / 1000;
    const left = sent && seconds > 2 ? leftText((seconds * (all - sent)) / sent) : "";
    const title = t("Adding photos: {done} of {all}", { done: ended, all: entries.length });
    return [
      h("div", { class: "ed-activity__head" },
        h("strong", {}, title),
        h("span", { class: "small soft" }, left),
        h("button", { class: "button button--quiet", type: "button", onclick: () => this.uploads.cancel() }, t("Cancel"))),
      h("progress", { class: "progress", max: Math.max(all, 1), value: sent, "aria-label": title }),
      h("ul", { class: "ed-files__list small" },
        ...entries.filter(({ state }) => state === "sending").map(sendingRow),
        ...failedRows(entries)),
    ];
  }

  _sent() {
    const { entries } = this.uploads;
    const again = entries.some(canGoAgain);
    return [
      h("div", { class: "ed-activity__head" },
        h("strong", { dataset: { testid: "upload-summary" } }, this._summary().join(" ")),
        h("button", { class: "icon-button", type: "button", "aria-label": t("Close"), onclick: () => this._close() }, icon("close"))),
      h("ul", { class: "ed-files__list small" }, ...imageOffers(entries, this), ...failedRows(entries)),
      again && h("button", { class: "button", type: "button", onclick: () => this.uploads.retry() }, icon("retry"), t("Try these again")),
    ].filter(Boolean);
  }

  /** The results of the uploads in sentences, with the number of photos now in the tray. */
  _summary() {
    const { entries } = this.uploads;
    const results = entries.filter(({ state }) => state === "done").map(({ result }) => result);
    const count = (test) => results.filter(test).length;
    const failed = entries.filter(({ state }) => state === "failed").length;
    const cancelled = entries.filter(({ state }) => state === "cancelled").length;
    const [known, placed] = [count((r) => r.duplicate), count((r) => r.placed && !r.duplicate)];
    const waiting = count((r) => !r.duplicate && this.store.photos.has(r.id) && !this.store.isPlaced(r.id));
    const outside = count((r) => !r.duplicate && isOutside(this.store, r.id));
    const sentences = [
      placed && tn("{n} photo placed by its GPS.", "{n} photos placed by their GPS.", placed),
      waiting && tn("{n} photo waits in the tray.", "{n} photos wait in the tray.", waiting),
      outside && tn("{n} of them was taken outside the image, by its GPS.", "{n} of them were taken outside the image, by their GPS.", outside),
      known && tn("{n} photo was already here.", "{n} photos were already here.", known),
      failed && tn("{n} file failed.", "{n} files failed.", failed),
      cancelled && tn("{n} file was not sent.", "{n} files were not sent.", cancelled),
    ].filter(Boolean);
    return sentences.length ? sentences : [tn("{n} photo added.", "{n} photos added.", results.length)];
  }

  _close() {
    this.uploads.entries = [];
    this._files();
  }

  _jobs() {
    const { jobs } = this.store;
    const overtaken = (job) => job.state === "done" && jobs.some(({ kind, id }) => kind === job.kind && id > job.id);
    const shown = jobs.filter((job) => !(job.state === "failed" && isDismissed(job.id)) && !overtaken(job));
    const signature = JSON.stringify(shown);
    if (signature === this._shownJobs) return;
    this._shownJobs = signature;
    const focused = document.activeElement?.getAttribute("data-job");
    this.jobsBox.replaceChildren(...shown.map((job) => this._job(job)));
    if (focused) queryAll(`[data-job="${focused}"]`, HTMLElement, this.jobsBox)[0]?.focus();
    this._frame();
  }

  _job(job) {
    const { id, kind, state, done, total, note, error } = job;
    const name = (JOBS[kind] || (() => sentence(kind)))();
    const going = state === "queued" || state === "running";
    const words = {
      queued: () => queuedText(job),
      running: () => (job.seconds_left === null ? note : leftText(job.seconds_left)),
      done: () => t("done"),
      failed: () => t("failed"),
      cancelled: () => t("cancelled"),
    };
    const value = total ? { value: Math.min(done, total), max: total } : {};
    return h("div", { class: `ed-job ed-job--${state}`, dataset: { testid: "job-progress", state, kind, done, total } },
      h("div", { class: "ed-activity__head" },
        h("strong", {}, name),
        h("span", { class: "small soft", title: note }, words[state]()),
        this._jobButton(job, going)),
      state === "running" && kind in REASONS && h("p", { class: "ed-job__why small soft" }, REASONS[kind]()),
      going && h("progress", { class: "progress", "aria-label": name, ...(state === "running" ? value : { value: 0, max: 1 }) }),
      kind === "street-photos" && state === "done" && h("p", { class: "small", "data-testid": "street-summary" }, addedSummary(job.result)),
      kind === "video-photos" && state === "done" && h("p", { class: "small", "data-testid": "video-summary" }, videoSummary(job.result)),
      error && h("p", { class: "small ed-job__error" }, [error.message, error.hint].filter(Boolean).map(sentence).join(". ")),
      state === "failed" && this._hide(id));
  }

  _jobButton({ id, state, mine }, going) {
    if (!(this.store.canEdit || mine) || state === "done") return null;
    const [words, ask] = going ? [t("Cancel"), "cancelJob"] : [t("Try again"), "retryJob"];
    const run = async (event) => {
      event.currentTarget.disabled = true;
      try {
        await this.server[ask](id);
        await this.refresh();
      } catch (problem) {
        toastError(problem);
      }
    };
    return h("button", { class: "button button--quiet", type: "button", onclick: run, dataset: { job: id } }, words);
  }

  _hide(id) {
    const hide = () => {
      dismiss(id);
      this._jobs();
    };
    return h("button", { class: "button button--quiet", type: "button", onclick: hide }, t("Hide"));
  }
}

/** Result of adding the photos of a video. */
function videoSummary({ with_position: placed, notes, added, failed }) {
  const positions = placed ? tn("{n} photo has a position.", "{n} photos have a position.", placed) : t("The video has no positions: place its photos by hand, or with the rest.");
  return [addedSummary({ added, failed }), positions, ...notes.map((note) => `${sentence(note)}.`)].join(" ");
}

/** Result of adding photos that a job has fetched or made. */
function addedSummary({ added, failed }) {
  const reasons = [...new Set(failed.map(({ reason }) => sentence(reason)))].slice(0, 3);
  return [
    tn("{n} photo added.", "{n} photos added.", added),
    failed.length && `${tn("{n} photo failed:", "{n} photos failed:", failed.length)} ${reasons.join(". ")}.`,
  ].filter(Boolean).join(" ");
}

/** Whether the GPS position of a photo in the tray is outside the image. */
function isOutside(store, id) {
  const photo = store.photos.get(id);
  const { satellite } = store;
  if (!satellite || !photo?.gps || store.isPlaced(id) || !Number.isFinite(photo.gps.x_px)) return false;
  return !isInside([photo.gps.x_px, photo.gps.y_px], satellite);
}

/** The button that folds the card, which starts folded to leave what is around it visible. */
function foldButton(card) {
  const button = h("button", { class: "icon-button ed-activity__fold", type: "button", "aria-controls": "activity" }, icon("chevron-down"));
  const fold = (folded) => {
    card.classList.toggle("is-folded", folded);
    button.setAttribute("aria-expanded", String(!folded));
    button.setAttribute("aria-label", folded ? t("Show more") : t("Show less"));
  };
  button.addEventListener("click", () => fold(!card.classList.contains("is-folded")));
  fold(true);
  return button;
}

function sendingRow({ file, sent }) {
  return h("li", { class: "ed-file-row" },
    h("span", { class: "ed-file-row__name" }, file.name),
    h("progress", { class: "progress", max: Math.max(file.size, 1), value: sent, "aria-label": file.name }));
}

function failedRows(entries) {
  const failed = entries.filter(({ state }) => state === "failed");
  const rows = failed.slice(0, FAILURES_SHOWN).map(({ file, error }) =>
    h("li", { class: "ed-file-row ed-file-row--failed", dataset: { testid: "error-message" } },
      h("span", { class: "ed-file-row__name" }, file.name),
      h("span", {}, [error.message, error.hint].filter(Boolean).map(sentence).join(". "))));
  const more = failed.length - rows.length;
  return more > 0 ? [...rows, h("li", {}, tn("and {n} more", "and {n} more", more))] : rows;
}
