/** Offers to use an uploaded picture, which looks like a plan or satellite image, as the map's image. */

import { busy, confirmDialog } from "../shared/dialogs.js";
import { h } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { toast, toastError } from "../shared/toast.js";

/**
 * One row for each such picture among the uploads.
 * @param {Object[]} entries of uploads
 * @param {import("./activity.js").Activity} activity
 * @returns {HTMLElement[]}
 */
export function imageOffers(entries, { store, server, refresh }) {
  const offered = entries.filter(({ result }) => store.canEdit && result?.is_plan && store.photos.has(result.id));
  return offered.map(({ file, result }) => {
    const use = async (event) => {
      const placed = store.order.filter((id) => id !== result.id && store.isPlaced(id)).length;
      if (placed && !(await confirmed(placed))) return;
      await busy(event.target, async () => {
        await server.setSatellite(file, { tray: placed > 0 });
        await server.remove({ ids: [result.id] });
        await refresh();
        toast(t("The image is in place."));
      }).catch(toastError);
    };
    return h("li", { class: "ed-file-row ed-file-row--offer", dataset: { testid: "image-offer" } },
      h("span", { class: "ed-file-row__name" }, file.name),
      h("span", {}, t("It looks like a plan or a satellite image.")),
      h("button", { class: "button", type: "button", onclick: use }, t("Use as the map's image")));
  });
}

/** @param {number} placed number of photos on the present image */
function confirmed(placed) {
  return confirmDialog({
    title: t("Replace the map's image?"),
    text: tn(
      "{n} photo is already placed. If it is outside of the new image, it goes back to the tray.",
      "{n} photos are already placed. Those outside of the new image go back to the tray.",
      placed,
    ),
    action: t("Replace"),
  });
}
