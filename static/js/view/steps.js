/** The arrows in the photo, on a ring on the ground: each leads to a photo in its direction. */

import { h, icon } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { lengthText } from "../shared/format.js";

/** Half the width and height of the ring, as fractions of the frame's width. */
const REACH = { across: 0.17, down: 0.06 };

/** Shows the steps of the current photo; those of a photo without a heading have no direction in it. */
export class Steps {
  /**
   * @param {HTMLElement} ring
   * @param {import("./walk.js").Walk} walk
   * @param {{go: function(number): void, point: function(?number): void}} does `point`: shows where a step leads
   */
  constructor(ring, walk, does) {
    this.ring = ring;
    this.walk = walk;
    this.store = walk.store;
    this.does = does;
    /** @type {{step: import("./walk.js").Step, arrow: HTMLButtonElement}[]} */
    this.shown = [];
    this.store.on("current photos", () => this.show());
    this.store.on("look", () => this._turn());
  }

  /** The step in a direction, within 50 degrees. @param {number} direction clockwise from where one looks @returns {?number} id */
  towards(direction) {
    const near = (step) => Math.abs(relative(this._angle(step) - direction));
    const found = this.steps.toSorted((a, b) => near(a) - near(b))[0];
    return found && near(found) < 50 ? found.id : null;
  }

  /** Steps of the current photo that have a direction in it. */
  get steps() {
    const { currentId } = this.store;
    if (currentId === null || this.store.heading(currentId) === null) return [];
    return this.walk.steps(currentId).filter(({ id }) => this.store.photos.has(id));
  }

  show() {
    this.shown = this.steps.map((step) => ({ step, arrow: this._arrow(step) }));
    this.ring.replaceChildren(...this.shown.map(({ arrow }) => arrow));
    this.does.point(null);
    this._turn();
  }

  _arrow(step) {
    const { id } = step;
    const point = () => this.does.point(id);
    const off = () => this.does.point(null);
    return h("button", {
      class: `vw-step${step.turn ? " vw-step--turn" : ""}`, type: "button", dataset: { id, bearing: step.bearing },
      onclick: () => this.does.go(id), onpointerenter: point, onpointerleave: off, onfocus: point, onblur: off,
    }, icon("north"));
  }

  /** Degrees clockwise from the middle of the view. */
  _angle({ bearing }) {
    const { currentId, look } = this.store;
    return relative(bearing - this.store.heading(currentId) - (look?.id === currentId ? look.turn : 0));
  }

  /** Place the arrows around the viewer, who may look around in a panorama. */
  _turn() {
    for (const { step, arrow } of this.shown) {
      const angle = this._angle(step);
      const radians = (angle * Math.PI) / 180;
      const words = this._words(step, angle);
      arrow.style.setProperty("--x", (REACH.across * Math.sin(radians)).toFixed(4));
      arrow.style.setProperty("--y", (-REACH.down * Math.cos(radians)).toFixed(4));
      arrow.style.setProperty("--turn", `${angle.toFixed(1)}deg`);
      arrow.title = words;
      arrow.setAttribute("aria-label", words);
    }
  }

  _words({ id, turn }, angle) {
    const side = Math.abs(angle) < 45 ? t("ahead") : Math.abs(angle) > 135 ? t("back") : angle > 0 ? t("to the right") : t("to the left");
    if (turn) return t("Turn: {side}", { side });
    const [from, to] = [this.store.position(this.store.currentId), this.store.position(id)];
    const metres = this.store.georeference.metres(from, to);
    return t("{side}, {length}", { side, length: lengthText(metres, Math.hypot(from[0] - to[0], from[1] - to[1])) });
  }
}

/** An angle in [-180, 180). */
function relative(degrees) {
  return ((((degrees + 180) % 360) + 360) % 360) - 180;
}
