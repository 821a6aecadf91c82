/** Actions on the selected photos, in the toolbar so that they are always visible. */

import { byId } from "../../shared/dom.js";
import { tn } from "../../shared/i18n.js";
import { floorDialog } from "../floors/floor-dialog.js";
import { headingDialog } from "./heading-dialog.js";
import { noteDialog } from "./note-dialog.js";
import { timeDialog } from "./time-dialog.js";

/** Connect the bar. @param {import("../commands.js").Commands} commands */
export function connectSelection(commands) {
  const { store } = commands;
  const selected = () => store.order.filter((id) => store.selection.has(id));
  byId("selection-heading").addEventListener("click", () => headingDialog(commands, selected()));
  byId("selection-time").addEventListener("click", () => timeDialog(commands, selected()));
  byId("selection-note").addEventListener("click", () => noteDialog(commands, selected()));
  byId("selection-tray").addEventListener("click", () => commands.toTray(selected()));
  byId("selection-floor").addEventListener("click", () => floorDialog(commands, selected()));
  byId("selection-remove").addEventListener("click", () => commands.remove(selected()));
  byId("selection-clear").addEventListener("click", () => store.setSelection([]));
  const render = () => {
    const { size } = store.selection;
    byId("toolbar").classList.toggle("has-selection", size > 0);
    byId("selection-bar").hidden = size === 0;
    byId("selection-count").textContent = tn("{n} selected", "{n} selected", size);
    byId("selection-time", HTMLButtonElement).disabled = !selected().some((id) => store.photos.get(id)?.taken_at);
    byId("selection-floor").hidden = !store.canEdit || !store.floors.length;
    byId("selection-floor", HTMLButtonElement).disabled = !selected().some((id) => store.isPlaced(id));
    byId("selection-tray", HTMLButtonElement).disabled = !selected().some((id) => store.isPlaced(id));
  };
  store.on("selection photos placement floor", render);
  render();
}
