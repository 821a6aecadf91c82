/** Signs of detected objects by their class; a class without a sign shows its first letter. */

import { inkOn, nthColour } from "./colour-scales.js";

const SVG = "http://www.w3.org/2000/svg";
const PERSON = "M12 4a2.6 2.6 0 1 1 0 5.200a2.600 2.600 0 1 1 0-5.200M7 20v-4.500c0-3 2-4.500 5-4.500s5 1.500 5 4.500V20";
const CAR = "M4 16v-4l2-5h12l2 5v4zM4 12h16M7.500 16v2M16.500 16v2";
const ANIMAL = "M7 11c-3 0-3-4 0-4s2 4 0 4M17 11c3 0 3-4 0-4s-2 4 0 4M12 12c3 0 5 3 5 5s-3 2-5 2-5 0-5-2 2-5 5-5";
const FIRE = "M12 3c1 4 5 6 5 10.500a5 5 0 0 1-10 0C7 11 8.500 10 9 8c1.500 1 2 2 2 3 1-2 1.500-5 1-8";
const TREE = "M12 21v-5M12 3l6 8h-3l4 5H5l4-5H6z";
const HOUSE = "M4 11l8-7 8 7v9H4zM10 20v-5h4v5";
const SIGN = "M12 21v-8M5 5h11l3 4-3 4H5z";
const BOX = "M4 8l8-4 8 4v8l-8 4-8-4zM4 8l8 4 8-4M12 12v8";
const HAZARD = "M12 4 3 20h18zM12 10v5M12 17.500h.01";

/** @type {Array<[RegExp, string]>} */
const SIGNS = [
  [/person|human|people|pedestrian|victim|man|woman|child/, PERSON],
  [/car|vehicle|truck|bus|van|bike|bicycle|motor/, CAR],
  [/animal|dog|cat|cow|horse|bird|sheep/, ANIMAL],
  [/fire|flame|smoke|heat/, FIRE],
  [/tree|plant|bush/, TREE],
  [/house|building|door|room|stairs/, HOUSE],
  [/sign|marker|tag|landmark|light/, SIGN],
  [/box|barrel|bag|backpack|crate|drill|extinguisher|rope|phone|helmet/, BOX],
  [/hazard|danger|warning|gas|hole|obstacle|debris/, HAZARD],
];

/** Signs and colours of the classes there are, in the order in which they came. */
export class Symbols {
  constructor() {
    this.kinds = new Map();
  }

  /** @param {string} kind @returns {{colour: string, ink: string, path: ?string, letter: string}} */
  of(kind) {
    const known = this.kinds.get(kind);
    if (known) return known;
    const colour = nthColour(this.kinds.size);
    const path = SIGNS.find(([words]) => words.test(kind.toLowerCase()))?.[1] || null;
    const made = { colour, ink: inkOn(colour), path, letter: (kind.trim()[0] || "?").toUpperCase() };
    this.kinds.set(kind, made);
    return made;
  }

  /** The sign as an element. */
  element(kind) {
    const { colour, ink, path, letter } = this.of(kind);
    const svg = make("svg", { class: "mi-symbol", viewBox: "0 0 32 32", "aria-hidden": "true" });
    svg.append(make("circle", { cx: 16, cy: 16, r: 15, fill: colour }));
    if (path) {
      const drawing = { d: path, transform: "translate(5.500 5.500) scale(0.875)", fill: "none", stroke: ink, "stroke-width": 2 };
      svg.append(make("path", { ...drawing, "stroke-linecap": "round", "stroke-linejoin": "round" }));
    } else {
      const text = make("text", { x: 16, y: 22, "text-anchor": "middle", fill: ink, "font-size": 17, "font-weight": 700 });
      text.textContent = letter;
      svg.append(text);
    }
    return svg;
  }
}

function make(tag, attributes) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}
