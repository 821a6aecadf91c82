/** Two photos with lines between matching keypoints; zoomed by wheel, pinch, drag and double-click. */

import { colours } from "../shared/answer/answer-format.js";
import { h, svg as element } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { PhotoZoom } from "../shared/photo-zoom.js";

const GAP = 0.012;
const SURE = 0.75;
const FAINT = 0.35;

/**
 * @typedef {Object} Pair
 * @property {{src: string, name: string, width: number, height: number}} query upright
 * @property {{src: string, name: string, width: number, height: number}} photo
 * @property {{query_xy: number[][], photo_xy: number[][], inlier: number[]}} lines pixels of the upright photos
 */

/**
 * Make the picture.
 * @param {Pair} pair
 * @param {{all: boolean, shape: number}} options `all`: outliers, too; `shape`: width over height of the
 *   available space, which decides whether the photos are side by side or one above the other
 * @returns {HTMLElement}
 */
export function matchView({ query, photo, lines }, { all, shape }) {
  const { frame, places } = layout(query, photo, shape);
  const svg = element("svg", { viewBox: `0 0 ${frame.width} ${frame.height}`, class: "lo-pair-svg", role: "img" });
  svg.setAttribute("aria-label", t("{query} and {photo}", { query: query.name, photo: photo.name }));
  for (const [n, { src }] of [query, photo].entries()) {
    const at = places[n];
    svg.append(element("image", { href: src, x: at.x, y: at.y, width: at.width, height: at.height, preserveAspectRatio: "none" }));
  }
  const sure = lines.inlier.some(Boolean);
  const order = lines.inlier.map((_, n) => n).sort((a, b) => lines.inlier[a] - lines.inlier[b]);
  for (const n of order) {
    const inlier = Boolean(lines.inlier[n]);
    if (!inlier && sure && !all) continue;
    const [from, to] = [shown(lines.query_xy[n], query, places[0]), shown(lines.photo_xy[n], photo, places[1])];
    svg.append(...line(from, to, { colour: inlier ? colours.inlier : colours.outlier, opacity: inlier || !sure ? SURE : FAINT }));
  }
  const box = h("div", { class: "lo-pair-frame" });
  box.style.aspectRatio = `${frame.width} / ${frame.height}`;
  box.append(svg);
  new PhotoZoom(box, /** @type {*} */ (svg));
  return box;
}

/** Side by side at equal height, or one above the other at equal width: whichever shows the photos larger. */
function layout(query, photo, shape) {
  const ratios = [query, photo].map(({ width, height }) => width / height);
  const sideBySide = { width: ratios[0] + ratios[1] + GAP, height: 1 };
  const above = { width: 1, height: 1 / ratios[0] + 1 / ratios[1] + GAP };
  const scale = ({ width, height }) => Math.min(shape / width, 1 / height);
  // Compare the areas of the first photo in a space `shape` wide and 1 high.
  const sideBySideIsLarger = ratios[0] * scale(sideBySide) ** 2 >= (1 / ratios[0]) * scale(above) ** 2;
  const unit = 1000;
  if (sideBySideIsLarger) {
    const places = [
      { x: 0, y: 0, width: ratios[0] * unit, height: unit },
      { x: (ratios[0] + GAP) * unit, y: 0, width: ratios[1] * unit, height: unit },
    ];
    return { frame: { width: sideBySide.width * unit, height: unit }, places };
  }
  const places = [
    { x: 0, y: 0, width: unit, height: unit / ratios[0] },
    { x: 0, y: (1 / ratios[0] + GAP) * unit, width: unit, height: unit / ratios[1] },
  ];
  return { frame: { width: unit, height: above.height * unit }, places };
}

/** Position of a keypoint in the drawing; (0, 0) is a pixel centre. @param {number[]} keypoint */
function shown([x, y], { width, height }, place) {
  return [place.x + ((x + 0.5) / width) * place.width, place.y + ((y + 0.5) / height) * place.height];
}

/** @param {number[]} from @param {number[]} to */
function line([x1, y1], [x2, y2], { colour, opacity }) {
  const common = { stroke: colour, "stroke-opacity": opacity, "vector-effect": "non-scaling-stroke" };
  const dot = (cx, cy) => element("circle", { cx, cy, r: 5, fill: "none", "stroke-width": 1.25, ...common });
  return [element("line", { x1, y1, x2, y2, "stroke-width": 1.25, ...common }), dot(x1, y1), dot(x2, y2)];
}
