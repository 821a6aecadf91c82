/** The card of a camera: its photo, and where that leads. */

import { byId, h, icon } from "../shared/dom.js";
import { t } from "../shared/i18n.js";

/** Shows one photo at a time. */
export class CameraCard {
  /**
   * @param {Object} page
   * @param {string} page.slug
   * @param {string} page.unit
   * @param {function(number, string): string} page.address of a picture of a photo
   * @param {{step: function(number): void, look: function(): void, close: function(): void}} on
   */
  constructor({ slug, unit, address }, on) {
    this.box = byId("camera-card");
    this.page = { slug, unit, address };
    this.on = on;
  }

  /** @param {?Object} camera */
  show(camera) {
    this.box.hidden = !camera;
    if (!camera) return;
    const { slug, unit, address } = this.page;
    const button = (symbol, label, run) => h("button", { class: "icon-button", type: "button", "aria-label": label, title: label, onclick: run }, icon(symbol));
    const facts = [
      camera.placed ? t("Placed") : t("In the tray"),
      t("{n} {unit} over the placed cameras", { n: camera.at[2].toFixed(unit === "m" ? 1 : 0), unit }),
    ];
    this.box.replaceChildren(
      h("div", { class: "lm-card__head" },
        h("h2", { class: "lm-card__name" }, camera.name),
        button("chevron-left", t("Previous photo"), () => this.on.step(-1)),
        button("chevron-right", t("Next photo"), () => this.on.step(1)),
        button("close", t("Close"), this.on.close)),
      h("img", { class: "lm-card__photo", src: address(camera.id, "preview"), alt: camera.name }),
      h("p", { class: "small soft" }, facts.join(" · ")),
      h("div", { class: "row" },
        h("a", { class: "button button--primary", href: `/maps/${encodeURIComponent(slug)}/edit?photo=${camera.id}`, "data-testid": "open-in-editor" }, icon("pin"), t("Open in the editor")),
        h("button", { class: "button", type: "button", onclick: this.on.look }, icon("camera"), t("Look from here"))),
    );
  }
}
