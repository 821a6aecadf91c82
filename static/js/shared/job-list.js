/** A list of jobs with their purpose, progress and errors, updated without losing the focus. */

import { post } from "./api.js";
import { busy } from "./dialogs.js";
import { h, icon } from "./dom.js";
import { duration, moment, t } from "./i18n.js";
import { sentence, toastError } from "./toast.js";

/** The purpose of a job, if its name does not show it. */
export const REASONS = {
  index: () => t("New photos will be found on this map."),
  evaluate: () => t("It shows how often and how precisely photos are found."),
  "satellite-pyramid": () => t("Large images are cut into pieces, so that they move smoothly."),
  "mission-pieces": () => t("Long tracks are shown in pieces, so that they move smoothly."),
};

/** Whether a job has not ended. */
export function isLive({ state }) {
  return state === "queued" || state === "running";
}

/** The jobs of a list element. */
export class JobList {
  /**
   * @param {HTMLElement} list
   * @param {{refresh: function(): Promise<void>, title?: "h2"|"h3", maps?: boolean}} page `maps`: each job names its map
   */
  constructor(list, { refresh, title = "h2", maps = false }) {
    this.list = list;
    this.refresh = refresh;
    this.title = title;
    this.maps = maps;
    /** @type {Map<number, {row: HTMLElement, state: string}>} */
    this.shown = new Map();
  }

  /** Rebuild only rows with a new state: a focused button keeps the focus. @param {Object[]} jobs */
  show(jobs) {
    for (const [id, { row }] of this.shown) {
      if (jobs.some((job) => job.id === id)) continue;
      row.remove();
      this.shown.delete(id);
    }
    jobs.forEach((job, place) => {
      const known = this.shown.get(job.id);
      if (known?.state === job.state) update(known.row, job);
      else this._replace(known, job, place);
    });
  }

  _replace(known, job, place) {
    const focused = known?.row.contains(document.activeElement);
    const row = this._row(job);
    known?.row.remove();
    this.shown.set(job.id, { row, state: job.state });
    this.list.insertBefore(row, this.list.children[place] || null);
    if (focused) row.querySelector("button")?.focus();
    update(row, job);
  }

  _row(job) {
    const live = isLive(job);
    const ended = job.state === "failed" || job.state === "cancelled";
    return h("li", { class: "card job", "data-job": job.id },
      h("div", { class: "job__head" },
        h(this.title, {}, kindName(job.kind)),
        badge(job.state),
        h("span", { class: "small soft" }, moment(job.created_at))),
      job.can_change && live && this._action(job, "cancel", t("Cancel"), "close"),
      job.can_change && ended && this._action(job, "retry", t("Try again"), "retry"),
      h("p", { class: "job__why small soft" }, ...this._why(job)),
      (live || job.error) && h("div", { class: "job__body" }, live ? progress(job) : reason(job.error)));
  }

  /** For which map and why the job runs, and who started it. */
  _why({ kind, state, map, map_name: name, by, mine }) {
    const place = this.maps && map && h("a", { href: `/maps/${encodeURIComponent(map)}/jobs` }, name);
    const who = mine ? t("started by you") : by ? t("started by {name}", { name: by }) : t("started by a change");
    const parts = [place, who, h("span", { "data-part": "seconds" })].filter(Boolean);
    const why = state === "queued" ? null : REASONS[kind]?.();
    return [...parts.flatMap((part, n) => (n ? [" · ", part] : [part])), why && ` · ${why}`].filter(Boolean);
  }

  _action({ id }, what, label, symbol) {
    const button = h("button", { class: "button", type: "button" }, icon(symbol), label);
    const act = async () => {
      await post(`/jobs/${id}/${what}`);
      await this.refresh();
    };
    button.addEventListener("click", () => busy(button, act).catch(toastError));
    return button;
  }
}

function progress({ kind }) {
  return h("div", { class: "stack stack--tight", "data-testid": "job-progress" },
    h("progress", { class: "progress", "aria-label": kindName(kind) }),
    h("div", { class: "small soft number", "data-part": "words" }));
}

function update(row, job) {
  const { seconds, state } = job;
  const time = seconds === null ? "" : duration(seconds);
  row.querySelector('[data-part="seconds"]').textContent = !time ? t("not started yet") : state === "running" ? t("{time} so far", { time }) : t("took {time}", { time });
  const bar = row.querySelector("progress");
  if (!bar) return;
  if (state === "running" && job.total > 0) Object.assign(bar, { max: job.total, value: Math.min(job.done, job.total) });
  else bar.removeAttribute("value");
  row.querySelector('[data-part="words"]').textContent = words(job);
}

function words(job) {
  if (job.state === "queued") return queuedText(job);
  const parts = [job.total > 0 && t("{done} of {total}", { done: job.done, total: job.total }), job.note];
  if (job.seconds_left !== null) parts.push(t("about {time} left", { time: duration(job.seconds_left) }));
  return parts.filter(Boolean).join(" · ");
}

/** What a queued job is waiting for and when it is retried; "" if it only waits for a worker. */
function waitingFor({ state, note, next_try_s: pause }) {
  if (state !== "queued" || pause === null) return "";
  return [note, t("retrying in {time}", { time: duration(pause) })].join(" · ");
}

/** The text of a queued job: what it waits for, as far as that is known. */
export function queuedText(job) {
  const { behind } = job;
  if (!behind || waitingFor(job)) return waitingFor(job) || t("Queued");
  const name = behind.map_name ? `${kindName(behind.kind)} (${behind.map_name})` : kindName(behind.kind);
  const left = behind.seconds_left === null ? "" : t("about {time} left", { time: duration(behind.seconds_left) });
  return [t("Queued behind: {job}", { job: name }), left].filter(Boolean).join(" · ");
}

function reason(error) {
  return h("div", { class: "note note--danger" },
    icon("warning"),
    h("div", {}, h("div", {}, sentence(error.message)), error.hint && h("div", { class: "small" }, sentence(error.hint))));
}

function badge(state) {
  const looks = {
    queued: ["", t("waiting")],
    running: ["badge--accent", t("running")],
    done: ["badge--success", t("done")],
    failed: ["badge--danger", t("failed")],
    cancelled: ["badge--warning", t("cancelled")],
  };
  const [look, label] = looks[state];
  return h("span", { class: `badge ${look}` }, label);
}

/**
 * Name a kind of job.
 * @param {string} kind name used by the server
 * @returns {string}
 */
export function kindName(kind) {
  const names = {
    blur: t("Faces and number plates"),
    index: t("Index"),
    models: t("Fetching models"),
    import: t("Import"),
    export: t("Export"),
    duplicate: t("Copy"),
    sample: t("Sample map"),
    "satellite-pyramid": t("Large image"),
    "street-photos": t("Street-level photos"),
    "video-photos": t("Photos from a video"),
    "satellite-tiles": t("Satellite image from a map service"),
    health: t("Map health"),
    landmarks: t("Landmarks"),
    "photo-pieces": t("Which photos join"),
    "place-rest": t("Places for the rest"),
    "describe-library": t("Search on all maps"),
    evaluate: t("Evaluation"),
    "mission-delete": t("Deleting a mission"),
    "mission-fix": t("Localizing the photos of a mission"),
    "mission-fuse": t("Correct the track"),
    "mission-import": t("Importing tracks"),
    "mission-inspect": t("Reading a file with tracks"),
    "mission-pieces": t("Long tracks for display"),
    events: t("Notifications"),
    "photo-library": t("Album of a photo library"),
    "field-form": t("Export of a field form"),
    "mission-thin": t("Thinning old tracks"),
  };
  return names[kind] || sentence(kind.replaceAll(/[-_.]/g, " "));
}
