/** Credits of photos from a service, shown wherever the photos are. */

import { h } from "./dom.js";
import { t } from "./i18n.js";

/**
 * The credit of a photo, as a link to its source.
 * @param {{credit: string, url: (string|undefined)}} source
 */
export function creditLine({ credit, url }) {
  return url ? h("a", { href: url, rel: "noopener noreferrer", target: "_blank", "data-testid": "photo-credit" }, credit)
    : h("span", { "data-testid": "photo-credit" }, credit);
}

/**
 * The services that photos of a map are from, with their licences.
 * @param {Iterable<{source: (?{service: string, licence: string}|undefined)}>} photos
 * @returns {string} empty if no photo is from a service
 */
export function mapCredit(photos) {
  const terms = new Set();
  for (const { source } of photos) if (source) terms.add(`${source.service} (${source.licence})`);
  return terms.size ? t("Photos: {names}", { names: [...terms].sort().join(", ") }) : "";
}
