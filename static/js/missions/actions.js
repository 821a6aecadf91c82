/** What people do with a whole mission: import, correct, share, rename, delete. */

import { askDialog, busy, confirmDialog, openDialog } from "../shared/dialogs.js";
import { byId, h, queryAll } from "../shared/dom.js";
import { listenToDrops, usable } from "../shared/drop-files.js";
import { locale, t, tn } from "../shared/i18n.js";
import { toast, toastError } from "../shared/toast.js";
import { importDialog } from "./import-dialog.js";
import { ended, jobBar } from "./job-progress.js";
import { sharesDialog } from "./share-mission.js";

/**
 * Connect the buttons that the page has for who looks at it.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {function(): Promise<void>} refresh
 */
export function connectActions(store, refresh) {
  const server = store.server(store.id);
  const on = (name, run) => {
    for (const button of queryAll(`[data-does="${name}"]`, HTMLButtonElement)) {
      button.disabled = false; // until now a click would have been lost
      button.addEventListener("click", () => {
        button.closest("details")?.removeAttribute("open");
        Promise.resolve(run(button)).catch(toastError);
      });
    }
  };
  const take = (files) => importDialog({
    files,
    mission: async () => store.id,
    done: async (_, result) => {
      await refresh();
      tellImported(result);
    },
  });
  on("import", () => take([]));
  if (document.querySelector('[data-does="import"]')) listenToDrops(byId("drop"), (files) => files.length && take(usable(files)));
  on("fuse", (button) => busy(button, () => fuse(server, refresh)));
  on("share", () => sharesDialog(server));
  on("rename", () => rename(store, server));
  on("delete", () => bin(store, server));
}

/** What an import says when it is done; what could not be used is listed with its reason. */
function tellImported({ kind, tracks, objects, skipped, new: isNew }) {
  if (!isNew) return toast(t("Everything in this file was already here."));
  const poses = tracks.reduce((sum, track) => sum + track.poses, 0);
  const parts = [tn("{n} pose", "{n} poses", poses), objects && tn("{n} sighting of an object", "{n} sightings of objects", objects)];
  const hint = skipped.map(({ reason, count }) => `${reason}: ${count.toLocaleString(locale)}`).join("; ");
  return toast(`${kind}: ${parts.filter(Boolean).join(", ")}`, { hint: hint || null });
}

async function fuse(server, refresh) {
  const bar = jobBar(t("The tracks are being fused"));
  const dialog = openDialog(t("Fuse the tracks"), [
    h("p", { class: "soft" }, t("Combines odometry, GPS and visual fixes into one corrected track; the other tracks stay as they are.")), bar,
  ]);
  try {
    const { job } = await server.fuse();
    await ended(server.job, job, bar.showJob);
    await refresh();
    toast(t("The corrected track is in place."));
  } finally {
    dialog.close();
  }
}

function rename({ mission }, server) {
  askDialog({ title: t("Rename the mission"), label: t("Name"), value: mission.name, action: t("Rename") }, async (name) => {
    await server.change({ name });
    location.reload();
  });
}

async function bin({ mission }, server) {
  const title = t("Move {name} to the bin?", { name: mission.name });
  const text = t("It can be restored from there.");
  if (!(await confirmDialog({ title, text, action: t("Move to the bin") }))) return;
  await server.bin();
  location.assign("/missions");
}
