/** Actions on a whole mission: import, fuse, share, rename, delete. */

import { askDialog, busy, confirmDialog, field, openDialog } from "../shared/dialogs.js";
import { byId, h, queryAll } from "../shared/dom.js";
import { listenToDrops, usable } from "../shared/drop-files.js";
import { locale, t } from "../shared/i18n.js";
import { failureNote, isDismissed } from "../shared/job-failure.js";
import { isLive } from "../shared/job-list.js";
import { toast, toastError } from "../shared/toast.js";
import { lengthText, sourceName } from "./format.js";
import { resultText } from "./import/file-remarks.js";
import { importDialog } from "./import/wizard.js";
import { ended, jobBar } from "./job-progress.js";
import { phonesDialog } from "./phones-dialog.js";
import { sharesDialog } from "./share-mission.js";

/**
 * Connect the buttons that the page contains, depending on permissions.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {import("./track-lines.js").TrackLines} lines
 * @param {import("./live-events.js").Live} live
 * @param {?number} fusion id of the job of the last fusion, unless it is done
 */
export function connectActions(store, lines, live, fusion) {
  const server = store.server(store.id);
  const refresh = () => live.refresh();
  const on = (name, run) => {
    for (const button of queryAll(`[data-does="${name}"]`, HTMLButtonElement)) {
      button.disabled = false; // disabled until this listener is attached
      button.addEventListener("click", () => {
        button.closest("details")?.removeAttribute("open");
        Promise.resolve(run(button)).catch(toastError);
      });
    }
  };
  const take = (files) => importDialog({
    files,
    into: {
      wish: () => ({ mission: store.id }),
      look: async () => ({ place: { satellite: store.mission.satellite, lines: knownLines(store, lines) }, start: store.mission.start }),
    },
    done: async (_, results) => {
      await refresh();
      tellImported(results);
    },
  });
  on("import", () => take([]));
  if (document.querySelector('[data-does="import"]')) listenToDrops(byId("drop"), (files) => files.length && take(usable(files)));
  on("fuse", async (button) => {
    if (await confirmDialog({ ...fuseQuestion(store.mission.tracks), action: t("Correct") })) await busy(button, () => fuse(store, server, refresh));
  });
  on("unfuse", () => unfuse(server, refresh));
  const offerUnfuse = () => {
    for (const button of queryAll('[data-does="unfuse"]')) button.hidden = !store.mission.tracks.some(({ source }) => source === "fused");
  };
  store.on("missions", offerUnfuse);
  offerUnfuse();
  if (fusion !== null) showFusion(server, fusion, refresh).catch(toastError);
  on("phones", () => phonesDialog(server));
  on("share", () => sharesDialog(server));
  on("rename", () => rename(store, server));
  on("delete", () => bin(store, server, live));
}

/** Points of the present tracks, shown for orientation when another one is placed. */
function knownLines(store, lines) {
  const points = store.shown.map(({ key }) => lines.best(key)).filter(Boolean);
  return points.map(({ lat, lon }) => lat.map((value, n) => [value, lon[n]])).filter((line) => line.length);
}

/** Show the result of an import, with the reasons for skipped data. */
function tellImported(results) {
  const hint = results.flatMap(({ skipped }) => skipped).map(({ reason, count }) => `${reason} (${count.toLocaleString(locale)})`).join("; ");
  toast(resultText(results), { hint: hint || null });
}

/**
 * Title and text of the question before the correction.
 * @param {Array<{source: string, timed: boolean, poses: number}>} tracks of the mission
 */
function fuseQuestion(tracks) {
  const known = new Set(tracks.filter(({ timed, poses, source }) => timed && poses && source !== "fused").map(({ source }) => source));
  const sources = new Intl.ListFormat(locale).format(["odometry", "gps", "visual", "manual"].filter((source) => known.has(source)).map(sourceName));
  const does = known.has("odometry") || known.size !== 1
    ? t("Combines {sources} into one corrected track.", { sources })
    : t("The only source is {sources}, so correcting smooths the track: it becomes a little shorter and its corners rounder.", { sources });
  const then = t("The cards, the coverage of areas and visitors then use it. The recorded tracks stay, and the corrected one can be removed in the menu (...).");
  return { title: t("Correct the track?"), text: `${does} ${then}` };
}

/** Remove the corrected track, after a question. */
async function unfuse(server, refresh) {
  const text = t("The recorded tracks stay, and are used again everywhere. You can correct the track again at any time.");
  if (!(await confirmDialog({ title: t("Remove the corrected track?"), text, action: t("Remove") }))) return;
  await server.removeFusion();
  await refresh();
}

/** @param {?number} [odometry] id of the track to correct; the server says if one has to be chosen */
async function fuse(store, server, refresh, odometry = null) {
  document.querySelector("[data-job-failure]")?.remove();
  try {
    const { job } = await server.fuse(odometry);
    await follow(server, job, refresh);
  } catch (error) {
    if (odometry !== null || error.where !== "odometry") throw error;
    chooseOdometry(store, (chosen) => fuse(store, server, refresh, chosen));
  }
}

/** Show the progress of a fusion until it ends. @param {number} id of the job */
async function follow(server, id, refresh) {
  const bar = jobBar(t("The track is being corrected"));
  const dialog = openDialog(t("Correct the track"), [
    h("p", { class: "soft" }, t("Combines odometry, GPS and visual fixes into one corrected track; the other tracks stay as they are.")), bar,
  ]);
  try {
    await ended(server.job, id, bar.showJob);
    await refresh();
  } finally {
    dialog.close();
  }
}

/** After a reload: show the fusion that is going on, or why the last one failed. @param {number} id of its job */
async function showFusion(server, id, refresh) {
  const job = await server.job(id);
  if (isLive(job)) await follow(server, id, refresh);
  else if (job.state === "failed" && !isDismissed(id)) byId("panel").prepend(failureNote(job));
}

/** Ask which odometry is to be corrected. */
function chooseOdometry(store, then) {
  const driven = store.mission.tracks.filter(({ source }) => source === "odometry").sort((a, b) => b.distance_m - a.distance_m);
  const choice = h("select", { class: "input" }, ...driven.map(({ id, name, distance_m }) => h("option", { value: String(id) }, `${name || t("Odometry")}, ${lengthText(distance_m)}`)));
  const go = h("button", { class: "button button--primary", type: "button", onclick: () => {
    dialog.close();
    then(Number(choice.value)).catch(toastError);
  } }, t("Correct the track"));
  const dialog = openDialog(t("Which odometry?"), [
    h("p", { class: "soft" }, t("Several were recorded at the same time.")), field(t("Odometry"), choice),
  ], { actions: [go] });
}

function rename({ mission }, server) {
  askDialog({ title: t("Rename the mission"), label: t("Name"), value: mission.name, action: t("Rename") }, async (name) => {
    await server.change({ name });
    location.reload();
  });
}

async function bin({ mission }, server, live) {
  const title = t("Move {name} to the bin?", { name: mission.name });
  const text = t("It can be restored from there.");
  if (!(await confirmDialog({ title, text, action: t("Move to the bin") }))) return;
  live.pause(); // the server refuses requests for a mission in the bin
  try {
    await server.bin();
  } catch (error) {
    live.start();
    throw error;
  }
  location.assign("/missions");
}
