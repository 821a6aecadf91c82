/** The photo on the whole screen; where the browser cannot do that (iPhone), on the whole page. */

import { icon } from "../shared/dom.js";

/** Switched by a button and by keys. */
export class WholeScreen {
  /** @param {HTMLElement} element @param {HTMLButtonElement} button */
  constructor(element, button) {
    this.element = element;
    this.button = button;
    button.addEventListener("click", () => this.toggle());
    document.addEventListener("fullscreenchange", () => this._show(document.fullscreenElement === element));
  }

  get on() {
    return this.element.classList.contains("is-whole");
  }

  toggle() {
    if (this.on) this.leave();
    else if (document.fullscreenEnabled) this.element.requestFullscreen().catch(() => this._show(true)); // refused: on the whole page
    else this._show(true);
  }

  leave() {
    if (document.fullscreenElement) document.exitFullscreen();
    else this._show(false);
  }

  _show(on) {
    this.element.classList.toggle("is-whole", on);
    this.button.setAttribute("aria-pressed", String(on));
    this.button.replaceChildren(icon(on ? "unfit" : "fit"));
  }
}
