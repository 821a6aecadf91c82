/** Symbols of detected objects by class; a class without a symbol gets a disc with its first letter. */

import { svg as make } from "../shared/dom.js";
import { inkOn, nthColour } from "./colour-scales.js";

const INK = "#14181a";
const DISC = "M3 16a13 13 0 1 0 26 0a13 13 0 1 0-26 0Z";

/**
 * @typedef {{pattern: string, frame: string, fill: string, glyph: string}} SymbolPaths in a box of 32 x 32
 * @typedef {{colour: string, ink: string, frame: string, glyph: ?string, letter: string}} Sign
 */

/** Symbols and colours of the classes. */
export class Symbols {
  /** @param {SymbolPaths[]} paths the first one whose pattern matches a class is used */
  constructor(paths) {
    this.paths = paths.map((one) => ({ ...one, pattern: new RegExp(one.pattern) }));
    /** @type {Map<string, Sign>} */
    this.kinds = new Map();
    this.plain = 0;
  }

  /** @param {string} kind @returns {Sign} */
  of(kind) {
    const known = this.kinds.get(kind);
    if (known) return known;
    const found = this.paths.find(({ pattern }) => pattern.test(kind.toLowerCase()));
    const colour = found ? found.fill : nthColour(this.plain++);
    const sign = {
      colour,
      ink: found ? INK : inkOn(colour),
      frame: found ? found.frame : DISC,
      glyph: found ? found.glyph : null,
      letter: (kind.trim()[0] || "?").toUpperCase(),
    };
    this.kinds.set(kind, sign);
    return sign;
  }

  /** The symbol as an element. */
  element(kind) {
    const { colour, ink, frame, glyph, letter } = this.of(kind);
    const svg = make("svg", { class: "mi-symbol", viewBox: "0 0 32 32", "aria-hidden": "true" });
    svg.append(make("path", { d: frame, fill: colour, stroke: INK, "stroke-width": 1.5, "stroke-linejoin": "round" }));
    if (glyph) {
      svg.append(make("path", { d: glyph, fill: "none", stroke: ink, "stroke-width": 1.8, "stroke-linecap": "round", "stroke-linejoin": "round" }));
    } else {
      const text = make("text", { x: 16, y: 22, "text-anchor": "middle", fill: ink, "font-size": 17, "font-weight": 700 });
      text.textContent = letter;
      svg.append(text);
    }
    return svg;
  }
}
