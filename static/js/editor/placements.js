/**
 * Several placements of the same photos: which one is shown, making and deleting one. A placement is there as long
 * as it has a photo, so making and deleting are edits like others, and can be undone.
 */

import { confirmDialog } from "../dialog.js";
import { h } from "../dom.js";
import { t } from "../i18n.js";
import { field, openDialog } from "./dialogs.js";
import { byId } from "./page.js";

/**
 * Connect the choice and its two menu items.
 * @param {import("./store.js").Store} store
 * @param {import("./edits.js").Edits} edits
 */
export function choosePlacement(store, edits) {
  const select = byId("placement");
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
  };
  select.addEventListener("change", () => store.showPlacement(select.value || null));
  byId("placement-new").addEventListener("click", () => ask(store, edits));
  byId("placement-delete").addEventListener("click", () => remove(store, edits));
  store.on("photos placement", render);
  let wanted = null;
  edits.addEventListener("saved", ({ detail }) => {
    if (detail.item.kind === "place" && detail.item.placement && detail.item.isNew) wanted = detail.item.placement;
  });
  store.on("photos", () => {
    if (wanted === null || !store.placements.has(wanted)) return;
    const name = wanted;
    wanted = null;
    store.showPlacement(name);
  });
  render();
}

function ask(store, edits) {
  const name = h("input", { class: "input", value: "clusters", maxlength: 60, pattern: "[A-Za-z0-9_\\-]+", required: true, autocomplete: "off" });
  const from = h("select", { class: "select" },
    h("option", { value: "clusters" }, t("photos that are near each other, gathered")),
    h("option", { value: "exact" }, t("the exact positions")));
  const { width = 1000, height = 1000 } = store.satellite || {};
  const radius = h("input", { class: "input", type: "number", min: 1, value: Math.round(Math.max(width, height) / 20), inputmode: "numeric", required: true });
  const reach = field(t("Gathered within, in pixels"), radius);
  from.addEventListener("change", () => (reach.hidden = from.value !== "clusters"));
  const make = h("button", { class: "button button--primary", type: "button" }, t("Create"));
  const dialog = openDialog(t("New placement"), [
    h("p", { class: "soft" }, t("The same photos at other positions. Each placement gives a map file of its own.")),
    field(t("Name"), name, t("Letters, digits, - and _")),
    field(t("Start from"), from),
    reach,
  ], { actions: [make] });
  make.addEventListener("click", () => {
    name.setCustomValidity(store.placements.has(name.value) ? t("There is a placement of this name already.") : "");
    if (!name.reportValidity() || !radius.reportValidity()) return;
    const placed = store.order.map((id) => store.photos.get(id)).filter(({ x_px: x }) => x !== null);
    const spots = placed.map(({ id, x_px: x, y_px: y }) => ({ id, at: [x, y] }));
    const moved = from.value === "clusters" ? gathered(spots, Number(radius.value)) : spots;
    if (moved.length) edits.begin(name.value, moved.map(({ id, at: [x_px, y_px] }) => ({ id, x_px, y_px })));
    dialog.close();
  });
}

/**
 * Bring photos that are near each other to their common middle.
 * @param {Array<{id: number, at: [number, number]}>} spots
 * @param {number} radius of what one middle gathers, in map pixels
 */
export function gathered(spots, radius) {
  const left = new Set(spots);
  const result = [];
  for (const spot of spots) {
    if (!left.has(spot)) continue;
    const near = [...left].filter(({ at }) => Math.hypot(at[0] - spot.at[0], at[1] - spot.at[1]) <= radius);
    const mean = (axis) => Math.round((near.reduce((sum, { at }) => sum + at[axis], 0) / near.length) * 100) / 100;
    const middle = [mean(0), mean(1)];
    for (const member of near) {
      left.delete(member);
      result.push({ id: member.id, at: middle });
    }
  }
  return result;
}

async function remove(store, edits) {
  const name = store.placement;
  const sure = await confirmDialog({
    title: t("Delete the placement {name}?", { name }),
    text: t("The photos and their exact positions stay."),
    action: t("Delete"),
    danger: true,
  });
  if (!sure) return;
  const ids = [...store.placements.get(name).keys()];
  edits.edit("unplace", ids.map((id) => ({ id, x_px: null, y_px: null })), name);
  store.showPlacement(null);
}
