/** The page with the jobs of a map: asks once a second while it can be seen and a job is active. */

import { get, post } from "../shared/api.js";
import { busy } from "../shared/dialogs.js";
import { h, icon } from "../shared/dom.js";
import { duration, moment, t } from "../shared/i18n.js";
import { sentence, toastError } from "../shared/toast.js";

const BUSY_MS = 1000;
const IDLE_MS = 5000;

const { map, canEdit } = JSON.parse(document.getElementById("page").textContent);
const list = document.getElementById("jobs");
const empty = document.getElementById("no-jobs");
const shown = new Map();

watch();

async function watch() {
  let wait = IDLE_MS;
  if (!document.hidden) {
    try {
      const { jobs } = await get(`/jobs?map=${encodeURIComponent(map)}`);
      show(jobs);
      if (jobs.some(isLive)) wait = BUSY_MS;
    } catch (error) {
      if (error.code !== "offline") toastError(error);
      if (error.status >= 400 && error.status < 500) return;
    }
  }
  setTimeout(watch, wait);
}

function isLive(job) {
  return job.state === "queued" || job.state === "running";
}

/** Only what has changed is rebuilt: a button that has the focus keeps it. */
function show(jobs) {
  empty.hidden = jobs.length > 0;
  for (const [id, known] of shown) {
    if (!jobs.some((job) => job.id === id)) {
      known.row.remove();
      shown.delete(id);
    }
  }
  jobs.forEach((job, place) => {
    const known = shown.get(job.id);
    if (known?.state === job.state) update(known.row, job);
    else {
      const row = draw(job);
      known?.row.remove();
      shown.set(job.id, { row, state: job.state });
      list.insertBefore(row, list.children[place] || null);
    }
  });
}

function draw(job) {
  const live = isLive(job);
  const row = h(
    "li",
    { class: "card job", "data-job": job.id },
    h(
      "div",
      { class: "job__head" },
      h("h2", {}, kindName(job.kind)),
      badge(job.state),
      h("span", { class: "small soft" }, moment(job.created_at)),
    ),
    may(job) && live && action(t("Cancel"), "close", () => act(job, "cancel")),
    may(job) && (job.state === "failed" || job.state === "cancelled") && action(t("Try again"), "retry", () => act(job, "retry")),
    (live || job.error) && h("div", { class: "job__body" }, live ? progress(job) : reason(job.error)),
  );
  update(row, job);
  return row;
}

/** Editors may stop every job, others those that they have started. */
function may(job) {
  return canEdit || job.mine;
}

function progress(job) {
  return h(
    "div",
    { class: "stack stack--tight", "data-testid": "job-progress" },
    h("progress", { class: "progress", "aria-label": kindName(job.kind) }),
    h("div", { class: "small soft number", "data-part": "words" }),
  );
}

function update(row, job) {
  const bar = row.querySelector("progress");
  if (!bar) return;
  if (job.state === "running" && job.total > 0) Object.assign(bar, { max: job.total, value: Math.min(job.done, job.total) });
  else bar.removeAttribute("value");
  row.querySelector('[data-part="words"]').textContent = words(job);
}

function words(job) {
  if (job.state === "queued") return t("Queued");
  const parts = [job.total > 0 && t("{done} of {total}", { done: job.done, total: job.total }), job.note];
  if (job.seconds_left !== null) parts.push(t("about {time} left", { time: duration(job.seconds_left) }));
  return parts.filter(Boolean).join(" · ");
}

function reason(error) {
  return h(
    "div",
    { class: "note note--danger" },
    icon("warning"),
    h("div", {}, h("div", {}, sentence(error.message)), error.hint && h("div", { class: "small" }, sentence(error.hint))),
  );
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

function action(label, symbol, run) {
  const button = h("button", { class: "button", type: "button" }, icon(symbol), label);
  button.addEventListener("click", () => busy(button, run).catch(toastError));
  return button;
}

async function act(job, what) {
  await post(`/jobs/${job.id}/${what}`);
  const { jobs } = await get(`/jobs?map=${encodeURIComponent(map)}`);
  show(jobs);
}

/**
 * Name a kind of job.
 * @param {string} kind as the server calls it
 * @returns {string}
 */
export function kindName(kind) {
  const names = {
    index: t("Index"),
    import: t("Import"),
    export: t("Export"),
    duplicate: t("Copy"),
    sample: t("Sample map"),
    "satellite-pyramid": t("Large image"),
    "street-photos": t("Street-level photos"),
    "satellite-tiles": t("Satellite image from tiles"),
    health: t("Map health"),
    landmarks: t("Landmarks"),
    "place-rest": t("Places for the rest"),
    "mission-fuse": t("Fuse the tracks"),
    evaluate: t("Evaluation"),
  };
  return names[kind] || sentence(kind.replaceAll(/[-_.]/g, " "));
}
