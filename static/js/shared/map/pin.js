/** Markers with a number or letter in them. */

import { h } from "../dom.js";

/** A Leaflet icon. @param {string|number} text @param {string} [kind] further class */
export function pin(text, kind = "") {
  const made = h("span", { class: `sat-pin ${kind}` }, String(text));
  return L.divIcon({ html: made, className: "sat-pin-frame", iconSize: [28, 28], iconAnchor: [14, 14] });
}
