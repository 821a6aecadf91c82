/** Two photos with lines between matching keypoints; zoomed by wheel, pinch, drag and double-click. */

import { colours } from "../shared/answer/answer-format.js";
import { h, svg as element } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { PhotoZoom } from "../shared/photo-zoom.js";
import { afterPaint } from "../shared/timing.js";

const GAP = 0.012;
const SURE = 0.75;
const FAINT = 0.35;
const RING = 5;

/**
 * @typedef {Object} Pair
 * @property {{src: string, name: string, width: number, height: number}} query upright
 * @property {{src: string, name: string, width: number, height: number}} photo
 * @property {{query_xy: number[][], photo_xy: number[][], inlier: number[]}} lines pixels of the upright photos
 */

/**
 * Make the picture; the lines come a frame after the photos.
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
  afterPaint(() => svg.append(...drawnLines(query, photo, lines, { places, all })))();
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

/** A path for the inliers, and below it one for the outliers: two elements are drawn much sooner than thousands. */
function drawnLines(query, photo, { query_xy: from, photo_xy: to, inlier }, { places, all }) {
  const sure = inlier.some(Boolean);
  const path = (kind) =>
    inlier
      .map((is, n) => (Boolean(is) === kind ? line(shown(from[n], query, places[0]), shown(to[n], photo, places[1])) : ""))
      .join("");
  const drawn = (d, colour, opacity) =>
    element("path", { d, stroke: colour, "stroke-opacity": opacity, "stroke-width": 1.25, "vector-effect": "non-scaling-stroke", fill: "none" });
  const outliers = !sure || all ? [drawn(path(false), colours.outlier, sure ? FAINT : SURE)] : [];
  return sure ? [...outliers, drawn(path(true), colours.inlier, SURE)] : outliers;
}

/** Position of a keypoint in the drawing; (0, 0) is a pixel centre. @param {number[]} keypoint */
function shown([x, y], { width, height }, place) {
  return [place.x + ((x + 0.5) / width) * place.width, place.y + ((y + 0.5) / height) * place.height];
}

/** A line with a ring at both ends, as a part of a path. @param {number[]} from @param {number[]} to */
function line(from, to) {
  const point = (/** @type {number[]} */ [x, y]) => `${x.toFixed(1)} ${y.toFixed(1)}`;
  const ring = (/** @type {number[]} */ [x, y]) => `M${point([x - RING, y])}a${RING} ${RING} 0 1 0 ${2 * RING} 0a${RING} ${RING} 0 1 0 ${-2 * RING} 0`;
  return `M${point(from)}L${point(to)}${ring(from)}${ring(to)}`;
}
