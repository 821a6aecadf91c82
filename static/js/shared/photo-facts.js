/** What is known of a placed photo, as pairs of a label and its text or element. */

import { h } from "./dom.js";
import { clockText, headingText } from "./format.js";
import { t } from "./i18n.js";
import { copyablePlace } from "./map/positions.js";
import { creditLine } from "./photo-credit.js";
import { WRITTEN } from "./written-facts.js";

/**
 * The facts of a photo that are there; a share leaves some out.
 * @param {import("./map/map-store.js").MapStore} store
 * @param {Object} photo
 * @returns {Array<Array<string|HTMLElement>>}
 */
export function photoFacts(store, photo) {
  const place = [photo.x_px, photo.y_px];
  const latLon = store.georeference.latLon(place);
  const heading = store.heading(photo.id);
  return [
    [t("Placed at"), `x ${Math.round(place[0])}, y ${Math.round(place[1])}`],
    latLon && [t("Coordinates"), copyablePlace(latLon)],
    heading !== null && [t("Heading"), headingText(heading)],
    photo.taken_at && [t("Taken"), clockText(photo.taken_at)],
    photo.camera && [t("Camera"), photo.camera],
    ...WRITTEN.map(({ name, label }) => photo[name] && [label, h("span", { class: "note-text" }, photo[name])]),
    photo.source && [t("From"), creditLine(photo.source)],
    photo.original && [t("File"), h("a", { href: photo.original, download: true }, t("original"))],
  ].filter(Boolean);
}

/** The facts as elements of a list. @param {Array<Array<string|HTMLElement>>} facts */
export function factElements(facts) {
  return facts.flatMap(([label, value]) => [h("dt", {}, label), h("dd", {}, value)]);
}
