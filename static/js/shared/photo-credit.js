/** Whom photos are from that come from a service: named wherever they are shown. */

import { h } from "./dom.js";
import { t } from "./i18n.js";

/**
 * The line that goes with a photo, as a link to where it is from.
 * @param {{credit: string, url: (string|undefined)}} source
 */
export function creditLine({ credit, url }) {
  return url ? h("a", { href: url, rel: "noopener noreferrer", target: "_blank", "data-testid": "photo-credit" }, credit)
    : h("span", { "data-testid": "photo-credit" }, credit);
}

/**
 * The services that photos of a map are from, with their licences.
 * @param {Iterable<{source: (?{service: string, licence: string}|undefined)}>} photos
 * @returns {string} empty where all photos are the map's own
 */
export function mapCredit(photos) {
  const terms = new Set();
  for (const { source } of photos) if (source) terms.add(`${source.service} (${source.licence})`);
  return terms.size ? t("Photos: {names}", { names: [...terms].sort().join(", ") }) : "";
}
