/** The form of the options menu: method, features and prior knowledge about the photo. */

import { byId } from "../shared/dom.js";
import { lengthText } from "../shared/format.js";
import { t } from "../shared/i18n.js";

const USUAL = { method: "auto", features: "auto", fov: "", heading_deg: "" };

/** The options of the next query. */
export class Options {
  /**
   * @param {import("../shared/answer/query-session.js").QuerySession} session
   * @param {import("../shared/map/map-store.js").MapStore} store
   * @param {function(): void} askAgain
   */
  constructor(session, store, askAgain) {
    this.session = session;
    this.store = store;
    this.form = byId("options-form", HTMLFormElement);
    this.menu = byId("options", HTMLDetailsElement);
    this.form.addEventListener("input", () => this._count());
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      if (!this.form.reportValidity()) return;
      this.menu.open = false;
      askAgain();
    });
    byId("hint-draw").addEventListener("click", () => {
      this.menu.open = false;
      session.setMode("hint");
      byId("map-canvas").focus({ preventScroll: true });
    });
    byId("hint-clear").addEventListener("click", (event) => {
      event.stopPropagation(); // the button hides itself, which would look like a click outside the menu
      session.setHint(null);
      byId("hint-draw").focus();
    });
    byId("options-reset").addEventListener("click", () => {
      for (const [name, value] of Object.entries(USUAL)) this._field(name).value = value;
      session.setHint(null);
    });
    let hint = null;
    session.on("hint", () => {
      this._count();
      if (session.hint && session.hint !== hint && session.query) askAgain();
      hint = session.hint;
    });
    session.on("query", () => this._count());
    this._count();
  }

  /** Fields of the request. */
  values() {
    const { hint } = this.session;
    const fields = Object.fromEntries(Object.keys(USUAL).map((name) => [name, this._field(name).value]));
    return hint ? { ...fields, hint_x_px: hint.x_px, hint_y_px: hint.y_px, hint_radius_px: hint.radius_px } : fields;
  }

  /** Whether a field can have a value. */
  offers(name, value) {
    return [...this._field(name).options].some((option) => option.value === value);
  }

  /** Set a field. */
  set(name, value) {
    this._field(name).value = value;
    this._count();
  }

  /** @returns {*} the input or select of a name */
  _field(name) {
    return this.form.elements.namedItem(name);
  }

  /** Show on the button how many options differ from their defaults. */
  _count() {
    const { hint, query } = this.session;
    const changed = Object.entries(USUAL).filter(([name, value]) => this._field(name).value !== value).length;
    const count = changed + (hint ? 1 : 0);
    const badge = byId("options-count");
    badge.hidden = !count;
    badge.textContent = String(count);
    byId("hint-clear").hidden = !hint;
    byId("hint-text").textContent = hint ? this._hintText(hint) : t("Places inside the circle become more probable.");
    byId("ask-again").hidden = !query;
  }

  _hintText({ radius_px }) {
    const scale = this.store.georeference.metresPerPixel;
    return t("Circle with a radius of {length}", { length: lengthText(scale && radius_px * scale, radius_px) });
  }
}
