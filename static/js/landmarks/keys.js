/** Keys that turn, fly and zoom as long as they are held down. */

const MOVES = {
  KeyW: ["forward", 1], KeyS: ["forward", -1], KeyA: ["right", -1], KeyD: ["right", 1], KeyE: ["up", 1], KeyQ: ["up", -1],
  ArrowLeft: ["turn", -1], ArrowRight: ["turn", 1], ArrowUp: ["tilt", 1], ArrowDown: ["tilt", -1],
  Equal: ["zoom", 1], NumpadAdd: ["zoom", 1], Minus: ["zoom", -1], NumpadSubtract: ["zoom", -1],
};
const FASTER = 4;

/** The movement that the held keys ask for. */
export class HeldKeys {
  /**
   * @param {HTMLElement} element that has the focus
   * @param {function(): void} changed called when a key goes down
   */
  constructor(element, changed) {
    this._held = new Set();
    element.addEventListener("keydown", (event) => {
      if (!MOVES[event.code] || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      this._fast = event.shiftKey;
      this._held.add(event.code);
      changed();
    });
    element.addEventListener("keyup", (event) => this._held.delete(event.code));
    element.addEventListener("blur", () => this._held.clear());
  }

  /**
   * Sum of the held keys by kind of movement; null if none is held.
   * @returns {?{forward: number, right: number, up: number, turn: number, tilt: number, zoom: number}}
   */
  get wanted() {
    if (!this._held.size) return null;
    const sum = { forward: 0, right: 0, up: 0, turn: 0, tilt: 0, zoom: 0 };
    for (const code of this._held) {
      const [kind, sign] = MOVES[code];
      sum[kind] += sign * (this._fast ? FASTER : 1);
    }
    return sum;
  }
}
