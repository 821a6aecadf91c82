/** Placing many photos at once: by their GPS, by a list of positions, by a track. */

import { openDialog } from "../shared/dialogs.js";
import { byId, h, icon } from "../shared/dom.js";
import { labelled, t, tn } from "../shared/i18n.js";
import { toast, toastError } from "../shared/toast.js";
import { listDialog } from "./list-dialog.js";
import { nameList } from "./name-list.js";
import { planDialog } from "./plan-dialog.js";
import { connectRest } from "./rest-dialog.js";
import { streetDialog } from "./street-dialog.js";
import { videoDialog } from "./video-dialog.js";
import { trackDialog } from "./track-dialog.js";

/**
 * Connect the menu.
 * @param {Object} page store, server, refresh and dots
 * @returns {{positions: function(?File): void, track: function(?File): void}} for dropped files
 */
export function bulkPlacing(page) {
  const { server, refresh } = page;
  const positions = (file = null) => listDialog(page, file, report);
  const track = (file = null) => trackDialog(page, file, report);
  byId("place-by-gps").addEventListener("click", async () => {
    try {
      const result = await server.placeByGps();
      await refresh();
      report(result, t("Place by GPS"));
    } catch (error) {
      toastError(error);
    }
  });
  byId("place-by-file").addEventListener("click", () => positions());
  byId("place-by-track").addEventListener("click", () => track());
  byId("place-the-rest").addEventListener("click", connectRest(page));
  byId("plan-button").addEventListener("click", () => planDialog(page));
  if (location.hash === "#next-photos") planDialog(page); // from the page Quality
  byId("street-button").addEventListener("click", () => streetDialog(page));
  byId("video-button").addEventListener("click", () => videoDialog(page));
  return { positions, track };
}

/** Show the result of placing: a message, or a dialog if something was left out. */
function report(result, title) {
  const placed = tn("{n} photo placed.", "{n} photos placed.", result.placed.length);
  const parts = [
    nameList(t("Outside the image"), (result.outside || []).map(({ name, reason }) => labelled(name, reason))),
    nameList(t("Not found on the track"), (result.unmatched || []).map(({ name, reason }) => labelled(name, reason))),
    nameList(t("Listed, but no photo has this name"), result.unknown || []),
    nameList(t("Ambiguous name"), result.ambiguous || []),
    result.missing ? h("p", {}, tn("{n} photo in the tray is not in the list.", "{n} photos in the tray are not in the list.", result.missing)) : null,
  ].filter(Boolean);
  if (!parts.length) {
    toast(result.placed.length ? placed : t("Nothing to place."));
    return;
  }
  openDialog(title, [h("p", { class: "row" }, icon("pin"), placed), ...parts]);
}
