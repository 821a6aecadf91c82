/** Blurring photos, and the bar above the tray that leads to photos with suggestions. */

import { byId, h, icon } from "../../shared/dom.js";
import { t, tn } from "../../shared/i18n.js";
import { toast, toastError } from "../../shared/toast.js";
import { blurDialog } from "../blur-dialog.js";

/** Delay of the request, so that photos load first. */
const AFTER_LOAD_MS = 1500;

/**
 * Open the dialog for some photos.
 * @param {import("../../shared/map/map-store.js").MapStore} store
 * @param {Object} server endpoints
 * @param {number[]} ids
 * @returns {?HTMLDialogElement} null if the details of the photos are not loaded yet
 */
export function blurPhotos(store, server, ids) {
  const photos = ids.map((id) => store.photos.get(id)).filter((photo) => photo?.preview);
  if (!photos.length) return null; // a large map whose details are still loading
  return blurDialog(photos, {
    blurredNow: ({ id }) => store.photos.get(id)?.blurred ?? [],
    suggest: ({ id }) => server.suggestBlur(id),
    save: async ({ id }, boxes, seen) => store.merge(await server.blur(id, boxes, seen)),
    searchAll: async () => {
      await server.searchBlur();
      toast(t("All photos of the map are being searched. What is found is shown above the photos."));
    },
  });
}

/** Connect the bar. @param {{store: Object, server: Object}} page */
export function connectBlurBar({ store, server }) {
  const bar = byId("blur-bar");
  const text = h("span", { class: "grow" });
  let ids = [];
  let ended = null;
  const ask = async () => {
    ids = (await server.blurFound()).photos.map(({ id }) => id);
    bar.hidden = !ids.length;
    text.textContent = tn("{n} photo has something to blur.", "{n} photos have something to blur.", ids.length);
  };
  /** A background request: if it fails, the bar stays unchanged until the next one. */
  const askQuietly = () => ask().catch(() => {});
  const open = () => {
    blurPhotos(store, server, ids)?.addEventListener("close", () => ask().catch(toastError));
  };
  bar.append(icon("blur"), text, h("button", { class: "button", type: "button", "data-testid": "blur-look", onclick: open }, t("Look at them")));
  store.on("jobs", () => {
    const done = store.jobs.findLast(({ kind, state }) => kind === "blur" && state === "done");
    if (!done || done.id === ended) return;
    ended = done.id;
    askQuietly();
  });
  setTimeout(askQuietly, AFTER_LOAD_MS);
}
