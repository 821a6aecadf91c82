/** Tracks as coloured lines with arrows of direction; the part after the chosen moment is faint. */

import { SCALE, stepOf, STEPS, trackColour, WIDTH_PX } from "./colour-scales.js";

const RIM = 3;
const ARROW_EVERY = 110;
const ARROW_CELL = 64;
const ARROW = 5;
const LATER = 0.22;
const SPARSE = new Set(["visual", "manual"]);

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Object} frame
 * @param {import("./scene.js").Scene} scene
 */
export function drawTracks(pen, frame, { store, lines }) {
  const drawn = [];
  pen.lineJoin = pen.lineCap = "round";
  for (const { mission, track, key } of store.shown.toReversed()) {
    const line = lines.best(key);
    if (!line?.length) continue;
    const seen = onScreen(line, frame);
    const until = line.indexAt(track.timed ? store.timeIn(mission) : Infinity);
    const own = trackColour(store, { mission, track });
    const width = track.look?.width_px ?? WIDTH_PX;
    const paint = { line, seen, until, own, width, sparse: SPARSE.has(track.source), range: track.timed ? rangeOf(store, lines, mission) : null };
    drawLine(pen, frame, paint, store.mode);
    if (!paint.sparse) drawn.push(paint);
  }
  const taken = new Set();
  for (const paint of drawn.toReversed()) drawArrows(pen, frame, paint, taken);
}

/** Values at the ends of the colour scale for a mission: times, or speeds. @returns {?[number, number]} */
function rangeOf(store, lines, mission) {
  if (store.mode === "speed") return [0, lines.fastest];
  return store.mode === "time" && store.clock ? [store.timeIn(mission, 0), store.timeIn(mission, store.clock.span)] : null;
}

function onScreen({ x, y, length }, frame) {
  const [xs, ys] = [new Float32Array(length), new Float32Array(length)];
  for (let n = 0; n < length; n += 1) {
    xs[n] = frame.x(x[n]);
    ys[n] = frame.y(y[n]);
  }
  return { xs, ys };
}

/** Whether a part of the segment that ends at a point may be in view. */
function isSeen({ xs, ys }, n, { x, y }) {
  const [a, b] = [n - 1, n];
  if (xs[a] < -20 && xs[b] < -20) return false;
  if (ys[a] < -20 && ys[b] < -20) return false;
  if (xs[a] > x + 20 && xs[b] > x + 20) return false;
  return !(ys[a] > y + 20 && ys[b] > y + 20) && xs[b] === xs[b];
}

function drawLine(pen, frame, paint, mode) {
  const { line, seen, until, own, width, sparse } = paint;
  const [past, later] = [[], []];
  for (let n = 1; n < line.length; n += 1) if (!line.gaps.has(n) && isSeen(seen, n, frame.size)) (n <= until ? past : later).push(n);
  if (sparse) {
    pen.setLineDash([2, 6]);
    stroke(pen, seen, past, { width: 1.5, colour: own });
    pen.setLineDash([]);
    return drawDots(pen, frame, paint);
  }
  pen.globalAlpha = LATER;
  stroke(pen, seen, later, { width, colour: own });
  pen.globalAlpha = 0.85;
  stroke(pen, seen, past, { width: width + RIM, colour: frame.ink.rim });
  pen.globalAlpha = 1;
  if (paint.range) {
    const steps = Array.from({ length: STEPS }, () => []);
    const values = mode === "time" ? line.time : line.speed;
    for (const n of past) steps[stepOf(values[n] || 0, paint.range)].push(n);
    steps.forEach((segments, step) => stroke(pen, seen, segments, { width, colour: SCALE[step] }));
  } else {
    stroke(pen, seen, past, { width, colour: own });
  }
}

/** Draw the segments that end at given points. */
function stroke(pen, { xs, ys }, ends, { width, colour }) {
  if (!ends.length) return;
  pen.beginPath();
  let before = -1;
  for (const n of ends) {
    if (n - 1 !== before) pen.moveTo(xs[n - 1], ys[n - 1]);
    pen.lineTo(xs[n], ys[n]);
    before = n;
  }
  pen.lineWidth = width;
  pen.strokeStyle = colour;
  pen.stroke();
}

function drawDots(pen, { size, ink }, { line, seen: { xs, ys }, until, own, width }) {
  for (let n = 0; n <= until && n < line.length; n += 1) {
    if (xs[n] < -9 || ys[n] < -9 || xs[n] > size.x + 9 || ys[n] > size.y + 9) continue;
    pen.beginPath();
    pen.arc(xs[n], ys[n], width + 1, 0, 2 * Math.PI);
    pen.fillStyle = own;
    pen.fill();
    pen.lineWidth = 1.5;
    pen.strokeStyle = ink.rim;
    pen.stroke();
  }
}

/** Draw arrows at even distances along the line, at most one per cell of the screen. */
function drawArrows(pen, { size }, { line, seen: { xs, ys }, until }, taken) {
  const end = Math.min(until, line.length - 1);
  let along = ARROW_EVERY / 2;
  pen.beginPath();
  for (let n = 1; n <= end; n += 1) {
    const [dx, dy] = [xs[n] - xs[n - 1], ys[n] - ys[n - 1]];
    const length = Math.hypot(dx, dy);
    if (line.gaps.has(n)) along = ARROW_EVERY / 2;
    else along += length;
    if (along < ARROW_EVERY || length < 2) continue;
    const steps = Math.min(Math.floor(along / ARROW_EVERY), 60);
    along %= ARROW_EVERY;
    for (let step = 0; step < steps; step += 1) {
      const back = Math.min((along + step * ARROW_EVERY) / length, 1);
      const [x, y] = [xs[n] - dx * back, ys[n] - dy * back];
      const cell = `${Math.floor(x / ARROW_CELL)};${Math.floor(y / ARROW_CELL)}`;
      if (x < 0 || y < 0 || x > size.x || y > size.y || taken.has(cell)) continue;
      taken.add(cell);
      chevron(pen, [x, y], [dx / length, dy / length]);
    }
  }
  for (const [width, colour] of [[4.5, "#ffffff"], [2, "#14181a"]]) {
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.stroke();
  }
}

function chevron(pen, [x, y], [dx, dy]) {
  const [backX, backY] = [x - dx * ARROW, y - dy * ARROW];
  pen.moveTo(backX - dy * ARROW, backY + dx * ARROW);
  pen.lineTo(x + dx * ARROW, y + dy * ARROW);
  pen.lineTo(backX + dy * ARROW, backY - dx * ARROW);
}
