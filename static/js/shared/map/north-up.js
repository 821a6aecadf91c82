/** The compass over a map: it shows where north is, and turns the image so that north is up. */

import { byId, takesText } from "../dom.js";
import { singleKeys } from "../single-keys.js";
import { KeptChoice } from "./kept-choice.js";

/** North counts as up within this angle. */
const LEAST_DEG = 1;
const KEY = "u";

/** Remembers for each map whether north is up; the button is hidden if the image has north up or no georeference. */
export class NorthUp {
  /**
   * @param {import("./map-view.js").MapView} view
   * @param {{ownKey?: boolean}} [does] `ownKey`: listens for its key; the editor has its own key bindings
   */
  constructor(view, { ownKey = true } = {}) {
    this.store = view.store;
    this.views = [view];
    this.kept = new KeptChoice("north-up", this.store.slug);
    this.button = byId("north-up", HTMLButtonElement);
    this.button.addEventListener("click", () => this.toggle());
    this.store.on("satellite", () => this.show());
    if (ownKey) document.addEventListener("keydown", (event) => this._key(event));
    this.show();
  }

  /** Whether north-up is chosen. */
  get on() {
    return this.kept.value !== null;
  }

  /** Turn another map of the same image along with the first one. @param {import("./map-view.js").MapView} view */
  follow(view) {
    this.views.push(view);
    this.show();
  }

  /** Switch between north up and the image upright. */
  toggle() {
    if (this.button.hidden) return;
    this.kept.value = this.on ? null : 1;
    this.show();
  }

  /** Rotate the maps and the needle. */
  show() {
    const north = northOf(this.store);
    for (const view of this.views) view.turnTo(this.on ? -north : 0);
    this.button.hidden = north === 0;
    this.button.setAttribute("aria-pressed", String(this.on && north !== 0));
    this.button.style.setProperty("--north", `${this.on ? 0 : north}deg`);
  }

  _key(event) {
    if (event.key.toLowerCase() !== KEY || event.ctrlKey || event.metaKey || event.altKey || this.button.hidden) return;
    if (event.defaultPrevented || takesText(event.target) || !singleKeys.on || document.querySelector("dialog[open]")) return;
    event.preventDefault();
    this.toggle();
  }
}

/** Direction of north in the middle of an image, degrees clockwise from image-up; 0 if nearly up or unknown. */
export function northOf({ satellite, georeference }) {
  if (!satellite) return 0;
  const north = georeference.north([satellite.width / 2, satellite.height / 2]);
  return Math.abs(north) > LEAST_DEG ? north : 0;
}
