/** The card of a camera: its photo and actions. */

import { byId, h, icon } from "../shared/dom.js";
import { locale, t } from "../shared/i18n.js";
import { creditLine } from "../shared/photo-credit.js";

/** A length in metres or map pixels, without its unit. @param {number} length @param {string} unit */
export function lengthText(length, unit) {
  const digits = unit === "m" ? 1 : 0;
  const rounded = Number(length.toFixed(digits)) || 0; // never "-0"
  return rounded.toLocaleString(locale, { minimumFractionDigits: digits });
}

/** Name of a camera's photo; visitors do not get file names. @param {{id: number, name: ?string}} camera */
export function nameOf({ id, name }) {
  return name ?? t("Photo {id}", { id });
}

/** Shows one photo at a time. */
export class CameraCard {
  /**
   * @param {Object} page
   * @param {?string} page.slug null for visitors, who cannot edit
   * @param {string} page.unit
   * @param {{step: function(number): void, look: function(): void, close: function(): void}} on
   */
  constructor({ slug, unit }, on) {
    this.box = byId("camera-card");
    this.page = { slug, unit };
    this.on = on;
  }

  /** @param {?Object} camera */
  show(camera) {
    this.box.hidden = !camera;
    if (!camera) return;
    const { slug, unit } = this.page;
    const name = nameOf(camera);
    const button = (symbol, label, run) => h("button", { class: "icon-button", type: "button", "aria-label": label, title: label, onclick: run }, icon(symbol));
    const facts = [
      slug !== null && (camera.placed ? t("Placed") : t("In the tray")),
      t("{n} {unit} over the placed cameras", { n: lengthText(camera.at[2], unit), unit }),
    ];
    this.box.replaceChildren(...[
      h("div", { class: "lm-card__head" },
        h("h2", { class: "lm-card__name" }, name),
        button("chevron-left", t("Previous photo"), () => this.on.step(-1)),
        button("chevron-right", t("Next photo"), () => this.on.step(1)),
        button("close", t("Close"), this.on.close)),
      camera.preview && h("img", { class: "lm-card__photo", src: camera.preview, alt: name }),
      h("p", { class: "small soft" }, facts.filter(Boolean).join(" · ")),
      camera.source && h("p", { class: "small soft" }, creditLine(camera.source)),
      h("div", { class: "lm-card__actions" },
        slug !== null && h("a", { class: "button button--primary", href: `/maps/${encodeURIComponent(slug)}/edit?photo=${camera.id}`, "data-testid": "open-in-editor" }, icon("pin"), t("Open in the editor")),
        h("button", { class: "button", type: "button", onclick: this.on.look }, icon("camera"), t("Look from here"))),
    ].filter(Boolean));
  }
}
