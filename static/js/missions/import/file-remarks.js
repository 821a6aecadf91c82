/** Messages about a file: progress, result, skipped and doubtful data. */

import { h, icon } from "../../shared/dom.js";
import { locale, t, tn } from "../../shared/i18n.js";
import { queuedText } from "../../shared/job-list.js";
import { sentence } from "../../shared/toast.js";

const SHORT = 6;
const SIGNS = { sending: "upload", reading: "table", ready: "route", refused: "warning", importing: "upload", done: "check", failed: "warning" };
const BUSY = new Set(["sending", "reading", "importing"]);

/**
 * A line with the name and progress of a file.
 * @param {import("./staged-file.js").StagedFile} file
 */
export function fileLine(file) {
  const isBusy = BUSY.has(file.state);
  return h("div", { class: `im-line${file.error && !isBusy ? " im-line--refused" : ""}`, "data-testid": "import-line" },
    icon(SIGNS[file.state]),
    h("div", { class: "im-line__text" }, h("strong", {}, file.name), h("span", { class: "small" }, lineText(file)), isBusy && barOf(file)));
}

function barOf({ name, state, file, sent, job }) {
  const bar = h("progress", { class: "progress", "aria-label": name });
  const { done, total } = state === "sending" ? { done: sent, total: file.size } : job ?? { done: 0, total: 0 };
  if (total > 0) Object.assign(bar, { max: total, value: Math.min(done, total) });
  return bar;
}

function lineText({ state, error, contents, result, job }) {
  if (state === "sending") return t("Sending the file...");
  if (state === "reading") return t("Reading the file");
  if (state === "importing") return job?.state === "queued" ? queuedText(job) : [t("Importing"), job?.note].filter(Boolean).join(" · ");
  if (error) return [error.message, error.hint].filter(Boolean).map(sentence).join(". ");
  if (state === "done") return resultText([result]);
  if (contents.table?.problem) return t("The columns are not recognized.");
  if (contents.problem) return sentence(contents.problem);
  return [sentence(contents.kind), tn("{n} track", "{n} tracks", contents.sources.length)].join(" · ");
}

/** Summary of imported data. @param {Array<Object>} results of their jobs */
export function resultText(results) {
  if (!results.some((result) => result.new)) return t("Everything in this file was already here.");
  const poses = results.flatMap(({ tracks }) => tracks).reduce((sum, track) => sum + track.poses, 0);
  const objects = results.reduce((sum, result) => sum + result.objects, 0);
  const left = results.flatMap(({ tracks }) => tracks).reduce((sum, { skipped }) => sum + skipped, 0);
  const parts = [tn("{n} position", "{n} positions", poses), left && tn("{n} left out", "{n} left out", left), objects && tn("{n} sighting of an object", "{n} sightings of objects", objects)];
  return `${[...new Set(results.map(({ kind }) => kind))].join(", ")}: ${parts.filter(Boolean).join(", ")}`;
}

/**
 * Titled lists of remarks.
 * @param {{notes?: string[], skipped: Array<Object>, doubts: Array<Object>}} remarks
 */
export function remarkList({ notes = [], skipped, doubts }) {
  const counted = (all) => all.map(({ count, reason, where }) => `${reason} (${count.toLocaleString(locale)}), ${where}`);
  const lists = [[t("How it was understood"), notes], [t("Left out"), counted(skipped)], [t("Odd"), counted(doubts)]];
  return lists.filter(([, lines]) => lines.length).map(([title, lines]) => h("div", {}, h("h3", { class: "small" }, title), folded(lines)));
}

/** A list whose later lines are folded. */
function folded(lines) {
  const items = (some) => h("ul", { class: "im-remarks small" }, ...some.map((line) => h("li", {}, sentence(line))));
  if (lines.length <= SHORT) return items(lines);
  const rest = lines.length - SHORT;
  return h("div", {}, items(lines.slice(0, SHORT)), h("details", {}, h("summary", { class: "small" }, tn("{n} more", "{n} more", rest)), items(lines.slice(SHORT))));
}
