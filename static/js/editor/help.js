/** Help on the keys of the editor, with a switch for the single-letter shortcuts. */

import { openDialog } from "../shared/dialogs.js";
import { h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { singleKeys } from "../shared/single-keys.js";

/** Show the help. */
export function showHelp() {
  const single = h("input", { type: "checkbox", checked: singleKeys.on });
  single.addEventListener("change", () => (singleKeys.on = single.checked));
  openDialog(t("Help"), [
    h("p", {}, t("Click on the image where the current photo was taken; the next photo follows automatically. Drag a dot to move it, and its arrow to set the direction of view.")),
    group(t("Anywhere"), [
      ["N, P", t("next, previous photo")],
      ["[, ]", t("turn the current photo by 5°")],
      ["+, −, 0", t("zoom in, zoom out, whole image")],
      ["U", t("north up, or the image as it is")],
      ["C", t("show the current photo on the image")],
      ["M", t("go to the image")],
      ["F", t("full-screen photo; arrow keys go to the next or previous")],
      ["D", t("measure a distance")],
      ["Ctrl + V", t("add a picture from the clipboard")],
      ["Delete", t("remove from the map")],
      ["Backspace", t("back to the tray")],
      ["Ctrl + Z", t("undo")],
      ["Ctrl + Shift + Z, Ctrl + Y", t("redo")],
      ["Esc", t("clear the selection; stop placing")],
    ]),
    group(t("On the image"), [
      ["← ↑ → ↓", t("move the crosshair; faster with Shift")],
      ["Enter", t("place the current photo, or select the dot")],
      [t("Space"), t("select the dot")],
      [t("Shift + click, Shift + drag"), t("select one, select a box")],
      [t("Long press"), t("select, on a touch screen")],
    ]),
    group(t("In the grid"), [
      ["← ↑ → ↓", t("go through the photos")],
      ["Enter", t("make it the current photo")],
      [t("Space"), t("select it")],
      ["Ctrl + A", t("select all")],
      ["Shift + F10", t("the menu of the photo, as by a right click")],
    ]),
    h("label", { class: "check" }, single, t("Single-letter shortcuts")),
  ]);
}

function group(title, rows) {
  return h("section", { class: "ed-keys" },
    h("h3", {}, title),
    h("dl", { class: "ed-keys__list" },
      ...rows.flatMap(([keys, what]) => [
        h("dt", {}, ...keys.split(", ").flatMap((key, n) => [n ? " " : "", h("kbd", {}, key)])),
        h("dd", {}, what),
      ])));
}
