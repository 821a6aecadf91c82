/** The form in which people read positions: degrees, minutes and seconds, UTM or MGRS; chosen in the menu of every page. */

import { copyButton } from "../clipboard.js";
import { h, queryAll } from "../dom.js";
import { t } from "../i18n.js";
import { latLonText } from "./coords.js";
import { dmsText, mgrsText, utmText } from "./grids.js";

const KEY = "expmap.positions";
const CHANGED = "expmap:positions";
const GRIDS = { utm: utmText, mgrs: mgrsText };

/** @type {string} one of the switch's `data-position-choice`; without storage (a frame of another site) that of this page only */
let form = stored() ?? "degrees";

/** The chosen form: `degrees`, `dms`, `utm` or `mgrs`. */
export const positionForm = () => form;

/** Run whenever another form was chosen. @param {function(): void} run */
export function onPositionForm(run) {
  addEventListener(CHANGED, run);
}

/** A position in the chosen form; in degrees where the grid has none. @param {number[]} place lat, lon */
export function placeText(place) {
  if (form === "dms") return dmsText(place);
  if (!GRIDS[form]) return latLonText(place);
  return GRIDS[form](place) ?? t("{position} (outside UTM)", { position: latLonText(place) });
}

/** A position in the chosen form, as programs and search fields accept it. @param {number[]} place lat, lon */
export function placeToCopy(place) {
  const degrees = () => place.map((value) => value.toFixed(7)).join(", ");
  if (form === "dms") return dmsText(place);
  return GRIDS[form]?.(place) ?? degrees();
}

/** A button that shows a position in the chosen form, also once another is chosen, and copies it. @param {number[]} place lat, lon */
export function copyablePlace(place) {
  return copyButton(h("span", { dataset: { position: place.join(",") } }, placeText(place)), () => placeToCopy(place));
}

/** Connect the switch, and fill elements with `data-position="lat,lon"`. */
export function connectPositions() {
  const buttons = queryAll("[data-position-choice]", HTMLButtonElement, document.body);
  const show = () => {
    for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.positionChoice === form));
    for (const element of queryAll("[data-position]", HTMLElement, document.body)) element.textContent = placeText(element.dataset.position.split(",").map(Number));
  };
  for (const button of buttons) button.addEventListener("click", () => choose(button.dataset.positionChoice));
  onPositionForm(show);
  addEventListener("storage", ({ key }) => key === KEY && choose(stored() ?? "degrees"));
  show();
}

function choose(chosen) {
  if (chosen === form) return;
  form = chosen;
  try {
    localStorage.setItem(KEY, chosen);
  } catch {
    // no storage: kept until the page is left
  }
  dispatchEvent(new Event(CHANGED));
}

function stored() {
  try {
    const kept = globalThis.localStorage?.getItem(KEY);
    return ["degrees", "dms", "utm", "mgrs"].includes(kept) ? kept : null;
  } catch {
    return null;
  }
}
