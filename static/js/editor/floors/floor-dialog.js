/** The dialog to move photos to another floor. */

import { openDialog } from "../../shared/dialogs.js";
import { h } from "../../shared/dom.js";
import { t, tn } from "../../shared/i18n.js";
import { levelText } from "../../shared/map/floor-switch.js";

/**
 * Ask for the floor.
 * @param {import("../commands.js").Commands} commands
 * @param {number[]} ids
 */
export function floorDialog(commands, ids) {
  const { store } = commands;
  const placed = ids.filter((id) => store.isPlaced(id));
  const there = new Set(placed.map((id) => store.floorOf(id)));
  const only = there.size === 1 ? [...there][0] : null;
  const choices = store.floors.toReversed().map(({ id, name, level }) => h("button", {
    class: "floor-choice", type: "button", disabled: id === only, "data-floor": id,
    onclick: () => (dialog.close(), commands.toFloor(placed, id)),
  }, h("span", { class: "floor-choice__level number" }, levelText(level)), name));
  const title = tn("To which floor is {n} photo moved?", "To which floor are {n} photos moved?", placed.length);
  const words = h("p", { class: "soft" }, t("Each stays where it is on the image."));
  const dialog = openDialog(title, [words, h("div", { class: "floor-choices" }, ...choices)]);
}
