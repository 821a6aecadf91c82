/** The dialog to mark a photo as a panorama and to mask parts of it by angles, boxes or an image. */

import { ACCEPTED } from "../../shared/accepted.js";
import { busy, errorLine, openDialog } from "../../shared/dialogs.js";
import { h, icon, targetOf } from "../../shared/dom.js";
import { t, tn } from "../../shared/i18n.js";
import { MaskBoxes } from "./mask-boxes.js";

const NEW = { x: 0.4, y: 0.6, width: 0.2, height: 0.2 };
const ASPECT = 2;
const TOLERANCE = 0.02;

/** Whether a photo has the aspect ratio of a full-sphere panorama. @param {{width: number, height: number}} photo */
export const isWholeSphere = ({ width, height }) => Math.abs(width / height - ASPECT) <= TOLERANCE;

/** @param {Object} box */
const isBand = ({ x, y, width, height }) => x === 0 && width === 1 && (y === 0 || y + height > 1 - 1e-6);

/**
 * Open the dialog for the current photo.
 * @param {import("../commands.js").Commands} commands
 * @param {Object} server endpoints
 */
export function panoramaDialog(commands, server) {
  const { store } = commands;
  const photo = store.current;
  const others = [...store.photos.values()].filter((other) => other.panorama && other.id !== photo.id);
  const image = h("img", { src: photo.preview, alt: photo.name, draggable: "false" });
  const frame = h("div", { class: "blur-frame mask-frame" }, image);
  const boxes = new MaskBoxes(frame, (photo.panorama?.masked ?? []).map((box) => ({ ...box })));
  const error = errorLine();
  const is = h("input", { type: "checkbox", checked: true });
  const all = h("input", { type: "checkbox", checked: !photo.panorama?.masked.length });
  const add = h("button", { class: "button", type: "button", onclick: () => boxes.add({ ...NEW }) }, icon("plus"), t("Add a box"));
  const file = h("input", { type: "file", accept: ACCEPTED.photos, class: "visually-hidden" });
  const send = h("button", { class: "button button--primary", type: "button" }, t("Save"));
  const masks = h("div", { class: "stack" },
    h("p", { class: "soft small" }, t("Mask what is not part of the place: robot, tripod, sky. Masked parts are ignored. Draw boxes, enter angles, or add an image that is black there.")),
    frame,
    h("div", { class: "row" }, add, h("label", { class: "button" }, file, icon("image"), t("Mask from an image …")), boxes.mask, boxes.count),
    angles(boxes),
    others.length ? h("label", { class: "check" }, all, h("span", {}, tn("The same for the {n} other panorama of the map", "The same for the {n} other panoramas of the map", others.length))) : null);
  const body = [h("label", { class: "check" }, is, h("span", {}, t("This photo is a panorama: it shows everything around"))), masks, error];
  const dialog = openDialog(t("Panorama"), body, { actions: [send] });
  dialog.classList.add("dialog--wide");
  is.addEventListener("change", () => { masks.hidden = !is.checked; });
  file.addEventListener("change", async () => {
    try {
      if (file.files[0]) boxes.replace((await server.readMask(file.files[0])).masked);
    } catch (problem) {
      error.show(problem);
    }
    file.value = "";
  });
  send.addEventListener("click", () => busy(send, async () => {
    const panorama = is.checked ? { masked: boxes.all } : null;
    const same = panorama && all.checked ? others : [];
    try {
      const changes = [photo, ...same].map(({ id }) => ({ id, panorama }));
      store.merge(await server.edit({ seen: store.revision, kind: "panorama", changes }));
      dialog.close();
    } catch (problem) {
      error.show(problem);
    }
  }));
}

/** Fields for two angles from the horizon, which correspond to full-width boxes. */
function angles(boxes) {
  const input = (band) => h("input", { class: "input", type: "number", min: "0", max: "90", step: "1", size: "3", value: String(band) });
  const bands = boxes.single.filter(isBand);
  const below = bands.find((box) => box.y > 0);
  const above = bands.find((box) => box.y === 0);
  const lowest = input(below ? Math.round(180 * below.y - 90) : 90);
  const highest = input(above ? Math.round(90 - 180 * above.height) : 90);
  const change = (event) => {
    if (!targetOf(event, HTMLInputElement).reportValidity()) return;
    const [low, high] = [lowest, highest].map(({ value }) => Number(value || 90));
    const old = new Set(boxes.single.filter(isBand));
    const others = boxes.all.filter((box) => !old.has(box));
    if (high < 90) others.push({ x: 0, y: 0, width: 1, height: (90 - high) / 180 });
    if (low < 90) others.push({ x: 0, y: (90 + low) / 180, width: 1, height: (90 - low) / 180 });
    boxes.replace(others);
  };
  for (const one of [lowest, highest]) one.addEventListener("change", change);
  return h("div", { class: "row small" },
    h("label", { class: "row" }, t("Used from"), lowest, t("° below the horizon")),
    h("label", { class: "row" }, t("up to"), highest, t("° above it")));
}
