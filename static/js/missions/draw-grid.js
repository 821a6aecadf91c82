/** The grid of a plain ground, with a spacing of a round number of metres. */

import { roundLength } from "../shared/map/coords.js";

const APART_PX = 70;
const STRONG_EVERY = 5;

/** @param {CanvasRenderingContext2D} pen @param {Object} frame of the scene */
export function drawGrid(pen, { size, scale, ink, x, y }) {
  const step = roundLength((APART_PX * 2) / scale);
  const first = (at) => Math.ceil(at / step);
  const [left, top] = [-x(0) / scale, -y(0) / scale];
  for (const strong of [false, true]) {
    pen.beginPath();
    for (let n = first(left); n * step <= left + size.x / scale; n += 1) {
      if ((n % STRONG_EVERY === 0) === strong) line(pen, [Math.round(x(n * step)) + 0.5, 0], [Math.round(x(n * step)) + 0.5, size.y]);
    }
    for (let n = first(top); n * step <= top + size.y / scale; n += 1) {
      if ((n % STRONG_EVERY === 0) === strong) line(pen, [0, Math.round(y(n * step)) + 0.5], [size.x, Math.round(y(n * step)) + 0.5]);
    }
    pen.lineWidth = 1;
    pen.strokeStyle = strong ? ink.gridStrong : ink.grid;
    pen.stroke();
  }
}

function line(pen, from, to) {
  pen.moveTo(...from);
  pen.lineTo(...to);
}
