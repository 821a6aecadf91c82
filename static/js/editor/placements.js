/** Placements of the photos: choosing, creating and deleting one. */

import { confirmDialog, errorLine, field, openDialog } from "../shared/dialogs.js";
import { byId, h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";

/**
 * Connect the selection and its two menu items.
 * @param {Object} page store, server and refresh
 */
export function choosePlacement(page) {
  const { store, server } = page;
  const select = byId("placement", HTMLSelectElement);
  const render = () => {
    const names = [null, ...store.placements.keys()];
    const signature = JSON.stringify([names, store.placement]);
    if (select.dataset.shown === signature) return;
    select.dataset.shown = signature;
    select.replaceChildren(
      ...names.map((name) => h("option", { value: name ?? "", selected: name === store.placement }, name ?? t("exact"))),
    );
    select.parentElement.hidden = names.length < 2;
    byId("placement-delete").hidden = store.placement === null;
    byId("export-cfg", HTMLAnchorElement).href = server.cfgOf(store.placement);
  };
  select.addEventListener("change", () => store.showPlacement(select.value || null));
  byId("placement-new").addEventListener("click", () => ask(page));
  byId("placement-delete").addEventListener("click", () => remove(page).catch(toastError));
  store.on("photos placement", render);
  render();
}

function ask({ store, server, refresh }) {
  const name = h("input", { class: "input", value: "clusters", maxlength: 60, pattern: "[A-Za-z0-9_\\-]+", required: true, autocomplete: "off" });
  const from = h("select", { class: "select" },
    h("option", { value: "clusters" }, t("clusters of nearby photos")),
    h("option", { value: "exact" }, t("the exact positions")));
  const { width = 1000, height = 1000 } = store.satellite || {};
  const radius = h("input", { class: "input", type: "number", min: 1, value: Math.round(Math.max(width, height) / 20), inputmode: "numeric", required: true });
  const reach = field(t("Cluster radius, in pixels"), radius);
  from.addEventListener("change", () => (reach.hidden = from.value !== "clusters"));
  const error = errorLine();
  const make = h("button", { class: "button button--primary", type: "button" }, t("Create"));
  const dialog = openDialog(t("New placement"), [
    h("p", { class: "soft" }, t("The same photos at other positions. Each placement has its own map file.")),
    field(t("Name"), name, t("Letters, digits, - and _")),
    field(t("Start from"), from),
    reach,
    error,
  ], { actions: [make] });
  make.addEventListener("click", async () => {
    name.setCustomValidity(store.placements.has(name.value) ? t("A placement with this name already exists.") : "");
    if (!name.reportValidity() || !radius.reportValidity()) return;
    make.disabled = true;
    try {
      await server.putPlacement(name.value, from.value === "clusters" ? { clusters_px: Number(radius.value) } : {});
      await refresh();
      store.showPlacement(name.value);
      dialog.close();
    } catch (problem) {
      error.show(problem);
      make.disabled = false;
    }
  });
}

async function remove({ store, server, refresh }) {
  const name = store.placement;
  const sure = await confirmDialog({
    title: t("Delete the placement {name}?", { name }),
    text: t("The photos and their exact positions stay."),
    action: t("Delete"),
    danger: true,
  });
  if (!sure) return;
  await server.deletePlacement(name);
  store.showPlacement(null);
  await refresh();
}
