/** The switch of floors on the map: a button for each level, the highest on top; hidden if there is only one image. */

import { h } from "../dom.js";
import { locale, t } from "../i18n.js";

/** A control of the map; follows the store. */
export class FloorSwitch {
  /**
   * @param {import("./map-store.js").MapStore} store
   * @param {HTMLElement} map around the canvas
   */
  constructor(store, map) {
    this.store = store;
    this.name = h("p", { class: "floor-switch__name", role: "status" });
    this.levels = h("div", { class: "floor-switch__levels", role: "group", "aria-label": t("Floors") });
    this.element = h("div", { class: "floor-switch", "data-testid": "floor-switch", hidden: true }, this.levels, this.name);
    map.append(this.element);
    store.on("floor", () => this.render());
    this.render();
  }

  render() {
    const { floors, floor } = this.store;
    this.element.hidden = !floors.length;
    this.name.textContent = this.store.floorNamed(floor)?.name ?? "";
    const hadFocus = this.levels.contains(document.activeElement);
    const buttons = floors.toReversed().map((one) => this._button(one));
    this.levels.replaceChildren(...buttons);
    if (hadFocus) buttons.find(({ ariaPressed }) => ariaPressed === "true")?.focus();
  }

  _button({ id, name, level }) {
    const label = `${levelText(level)}: ${name}`; // begins with the visible text, for voice control
    return h("button", {
      class: "icon-button number", type: "button", title: name, "aria-label": label, "aria-pressed": String(id === this.store.floor),
      "data-floor": id, onclick: () => this.store.showFloor(id),
    }, levelText(level));
  }
}

/** A level as shown on buttons. @param {number} level */
export function levelText(level) {
  return level.toLocaleString(locale, { maximumFractionDigits: 1 });
}

/**
 * A field to choose a floor, the highest on top.
 * @param {import("./map-store.js").Floor[]} floors
 * @param {number} chosen id
 * @param {string[][]} [more] further options (value, label), below
 */
export function floorSelect(floors, chosen, more = []) {
  const options = [...floors.toReversed().map(({ id, name }) => [String(id), name]), ...more];
  const select = h("select", { class: "select" }, ...options.map(([value, words]) => h("option", { value }, words)));
  select.value = String(chosen);
  return select;
}
