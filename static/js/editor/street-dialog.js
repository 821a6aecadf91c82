/** The dialog to add photos of an area from a street-level service: counted first, then added by a job. */

import { busy, errorLine, field, openDialog } from "../shared/dialogs.js";
import { h } from "../shared/dom.js";
import { sizeText } from "../shared/format.js";
import { labelled, t, tn } from "../shared/i18n.js";
import { toast } from "../shared/toast.js";
import { AreaBox } from "./area-box.js";

/**
 * Open the dialog.
 * @param {Object} page store, server, refresh, dots and view
 */
export async function streetDialog({ store, server, refresh, dots, view }) {
  const error = errorLine();
  const intro = h("p", { class: "soft" }, t("Adds photos taken by others, with their place, heading, author and licence."));
  const offered = await server.streetServices().catch((problem) => ({ problem, services: [] }));
  const missing = offered.problem ? null : reason(store, offered.services);
  if (offered.problem || missing) {
    openDialog(t("Street-level photos"), [intro, ...(missing ? [missing] : [error])]);
    if (offered.problem) error.show(offered.problem);
    return;
  }
  const source = h("select", { class: "select", "data-testid": "street-source" },
    ...offered.services.map(({ key, name }) => h("option", { value: key }, name)));
  const panoramas = h("select", { class: "select" },
    h("option", { value: "cut" }, t("cut into level views")),
    h("option", { value: "skip" }, t("leave out")),
    h("option", { value: "keep" }, t("keep as they are")));
  const outcome = h("div", { class: "stack stack--tight", "aria-live": "polite", "data-testid": "street-outcome" });
  const count = h("button", { class: "button", type: "button", "data-testid": "street-count" }, t("Count the photos"));
  const add = h("button", { class: "button button--primary", type: "button", disabled: true, "data-testid": "street-add" }, t("Add"));
  const inView = h("button", { class: "button button--quiet", type: "button" }, t("Use the visible area"));
  const dialog = openDialog(t("Street-level photos"), [
    intro,
    h("p", {}, t("Drag the corners of the area on the image."), " ", inView),
    field(t("Service"), source),
    field(t("Panoramas"), panoramas),
    outcome,
    error,
  ], { actions: [count, add], modeless: true });

  let turn = 0;
  const forget = () => {
    turn += 1;
    error.show(null);
    outcome.replaceChildren();
    dots.setMark([]);
    add.disabled = true;
    add.textContent = t("Add");
  };
  const area = new AreaBox(view, forget);
  const wish = () => ({ source: source.value, panoramas: panoramas.value, area: area.sides });
  const look = async () => {
    forget();
    const mine = turn;
    try {
      const found = await server.countStreet(wish());
      if (mine !== turn) return;
      outcome.replaceChildren(...summary(found));
      dots.setMark(found.positions);
      add.disabled = !found.to_download;
      if (found.to_download) add.textContent = tn("Add {n} photo", "Add {n} photos", found.to_download);
    } catch (problem) {
      if (mine === turn) error.show(problem);
    }
  };
  const start = async () => {
    try {
      await server.addStreet(wish());
      dialog.close();
      await refresh();
      toast(t("The photos are being added; each appears when it has arrived."));
    } catch (problem) {
      error.show(problem);
    }
  };
  source.addEventListener("change", forget);
  panoramas.addEventListener("change", forget);
  inView.addEventListener("click", () => area.ofView());
  count.addEventListener("click", () => busy(count, look));
  add.addEventListener("click", () => busy(add, start));
  dialog.addEventListener("close", () => {
    turn += 1;
    area.remove();
    dots.setMark([]);
  });
}

/** Why nothing can be added, with a remedy; null if it can. */
function reason(store, services) {
  const image = `/maps/${encodeURIComponent(store.slug)}/image`;
  if (!store.satellite || !store.georeference.grid) {
    return h("p", { "data-testid": "street-missing" }, t("The map needs a georeferenced image."), " ", h("a", { href: image }, t("Add one")));
  }
  if (services.length) return null;
  return h("p", { "data-testid": "street-missing" }, t("No service is set up. The server admin can add one in the settings: {names}.", { names: "street.panoramax, street.mapillary_token" }));
}

function summary(found) {
  const licences = Object.entries(found.licences).map(([name, n]) => labelled(name, n)).join(", ");
  const others = [
    found.panoramas && tn("{n} of them is a panorama.", "{n} of them are panoramas.", found.panoramas),
    found.known && tn("{n} is in the map already.", "{n} are in the map already.", found.known),
    found.outside && tn("{n} is outside the image.", "{n} are outside the image.", found.outside),
    found.skipped && tn("{n} panorama is left out.", "{n} panoramas are left out.", found.skipped),
    found.unusable && tn("{n} cannot be used.", "{n} cannot be used.", found.unusable),
  ].filter(Boolean);
  return [
    h("p", {}, h("strong", {}, found.to_download
      ? tn("{n} photo to download, about {size}", "{n} photos to download, about {size}", found.to_download, { size: sizeText(found.size_mb * 1e6) })
      : t("No photo to download"))),
    licences && h("p", { class: "small" }, t("Licences: {names}", { names: licences })),
    others.length > 0 && h("p", { class: "small soft" }, others.join(" ")),
  ].filter(Boolean);
}
