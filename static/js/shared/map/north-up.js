/** The compass over a map: it shows where north is, and turns the image so that north is up. */

import { byId, takesText } from "../dom.js";
import { singleKeys } from "../single-keys.js";
import { KeptChoice } from "./kept-choice.js";

/** An image that is turned by less has north up already. */
const LEAST_DEG = 1;
const KEY = "u";

/** Remembers for each map whether north is up; without a button that can be seen there is nothing to choose. */
export class NorthUp {
  /**
   * @param {import("./map-view.js").MapView} view
   * @param {{ownKey?: boolean}} [does] `ownKey`: listens to its key; the editor has a table of keys instead
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

  /** Whether north is wanted up. */
  get on() {
    return this.kept.value !== null;
  }

  /** Turn another map of the same image along with the first one. @param {import("./map-view.js").MapView} view */
  follow(view) {
    this.views.push(view);
    this.show();
  }

  /** North up, or the image again. */
  toggle() {
    if (this.button.hidden) return;
    this.kept.value = this.on ? null : 1;
    this.show();
  }

  /** Turn the maps and the needle as it is wanted. */
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

/** Where north is in the middle of an image, degrees clockwise from image-up; 0 where it is up, or not known. */
export function northOf({ satellite, georeference }) {
  if (!satellite) return 0;
  const north = georeference.north([satellite.width / 2, satellite.height / 2]);
  return Math.abs(north) > LEAST_DEG ? north : 0;
}
