/** Forms for the position of the image: corners and world files. */

import { byId, queryAll, targetOf } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { toast } from "../shared/toast.js";
import { page } from "./page.js";

const TWO = ["top_left", "bottom_right"];
const FOUR = ["top_left", "top_right", "bottom_left", "bottom_right"];

/**
 * Connect the form of the corners, filled with the present ones.
 * @param {function(): void} changed
 * @returns {function(): ?Object} body of the request; null while incomplete
 */
export function cornersForm(changed) {
  const all = byId("all-corners", HTMLInputElement);
  const names = () => (all.checked ? FOUR : TWO);
  const fill = (corners) => {
    all.checked = Boolean(corners.top_right && corners.bottom_left);
    for (const name of FOUR) {
      for (const axis of ["lat", "lon"]) byId(`${name}-${axis}`, HTMLInputElement).value = rounded(corners[name]?.[axis]);
    }
    show();
  };
  const show = () => {
    for (const box of queryAll("[data-corner]")) box.hidden = !names().includes(box.dataset.corner);
    changed();
  };
  const { corners } = page.earth || {};
  if (corners && FOUR.every((name) => corners[name])) {
    const straight = Math.abs(page.earth.north_deg) < 0.01;
    fill(straight ? { top_left: corners.top_left, bottom_right: corners.bottom_right } : corners);
  }
  byId("known-corners").addEventListener("input", changed);
  byId("known-corners").addEventListener("submit", (event) => event.preventDefault());
  all.addEventListener("change", show);
  byId("corners-json").addEventListener("change", async (event) => {
    const [file] = targetOf(event, HTMLInputElement).files;
    if (!file) return;
    try {
      fill(JSON.parse(await file.text()));
    } catch {
      toast(t("This file is not JSON."), { kind: "error" });
    }
  });
  return () => {
    const corner = (name) => ({ lat: byId(`${name}-lat`, HTMLInputElement).valueAsNumber, lon: byId(`${name}-lon`, HTMLInputElement).valueAsNumber });
    const given = Object.fromEntries(names().map((name) => [name, corner(name)]));
    const whole = Object.values(given).every(({ lat, lon }) => Number.isFinite(lat) && Number.isFinite(lon));
    return whole ? { kind: "corners", corners: given } : null;
  };
}

/**
 * Connect the form of a world file.
 * @param {function(): void} changed
 * @returns {function(): ?Object} like `cornersForm`
 */
export function worldfileForm(changed) {
  const text = byId("worldfile-text", HTMLTextAreaElement);
  byId("worldfile-file").addEventListener("change", async (event) => {
    const [file] = targetOf(event, HTMLInputElement).files;
    if (!file) return;
    text.value = (await file.slice(0, 10_000).text()).trim();
    changed();
  });
  byId("known-worldfile").addEventListener("input", changed);
  byId("known-worldfile").addEventListener("submit", (event) => event.preventDefault());
  return () => {
    const crs = byId("worldfile-crs", HTMLInputElement).value.trim() || null;
    return text.value.trim() ? { kind: "worldfile", worldfile: text.value, crs } : null;
  };
}

/** Degrees as text, to about a millimetre. */
function rounded(degrees) {
  return Number.isFinite(degrees) ? String(Number(degrees.toFixed(8))) : "";
}
