/** Marks over tracks and objects: uncertainty of visual fixes and last positions, gap of closed tracks, positions of robots. */

import { t } from "../shared/i18n.js";
import { sourceColour, trackColour } from "./colour-scales.js";
import { WITHIN_68 } from "./fixes.js";
import { lengthText, percentText } from "./format.js";

const ROBOT = 11;
const SMALL_GAP_PX = 14;
/** Corner of the map with the north arrow. */
const NORTH = { width: 56, height: 100 };
/** Sources of single positions, which do not show where the robot is now. */
const SPARSE = new Set(["visual", "manual"]);

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Object} frame
 * @param {import("./scene.js").Scene} scene
 */
export function drawMarks(pen, frame, { store, lines, hover }) {
  const several = store.missions.size > 1;
  drawFixes(pen, frame, store.fixes, store.timeIn(store.mission));
  if (store.moment === null) for (const shown of store.shown) drawClosing(pen, frame, shown.track, { line: lines.best(shown.key), received: !several });
  const moving = store.shown.filter(({ track }) => !SPARSE.has(track.source));
  const labelled = new Map(moving.toReversed().map(({ mission, key }) => [mission.id, key]));
  for (const { mission, track, key } of moving.toReversed()) {
    const at = store.moment === null ? newest(frame, track, lines.best(key)) : lines.at(key, store.timeIn(mission));
    const colour = trackColour(store, { mission, track });
    if (at?.covariance) drawEllipse(pen, frame, at, colour);
    if (at) drawRobot(pen, frame, at, { colour, label: several && labelled.get(mission.id) === key ? mission.name : "" });
    const pointed = hover === null ? null : lines.at(key, store.timeIn(mission, hover));
    if (pointed) drawPointed(pen, frame, pointed);
  }
}

function drawFixes(pen, frame, fixes, time) {
  const colour = sourceColour("visual");
  for (const { time: at, lat, lon, radius_m: radius, gated } of fixes) {
    const place = at <= time && frame.place(lat, lon);
    if (!place) continue;
    if (gated) cross(pen, frame, place);
    else circle(pen, place, { radius: Math.max(radius / frame.metresPerPixel, 5), colour });
  }
}

/** Circle of 68 % probability. */
function circle(pen, { x, y }, { radius, colour }) {
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  shade(pen, colour);
}

/** Fill and stroke the path. */
function shade(pen, colour) {
  pen.globalAlpha = 0.16;
  pen.fillStyle = colour;
  pen.fill();
  pen.globalAlpha = 1;
  pen.lineWidth = 1.75;
  pen.strokeStyle = colour;
  pen.stroke();
}

/** A fix that the fusion rejected. */
function cross(pen, { ink }, { x, y }) {
  pen.beginPath();
  for (const [dx, dy] of [[5, 5], [5, -5]]) {
    pen.moveTo(x - dx, y - dy);
    pen.lineTo(x + dx, y + dy);
  }
  for (const [width, colour] of [[5, "#ffffff"], [2.5, ink.current]]) {
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.stroke();
  }
}

/** A dashed line from the end of a track to its start, with the distance. */
function drawClosing(pen, frame, { closing }, { line, received }) {
  if (!closing || !line?.length) return;
  const end = line.length - 1;
  const [from, to] = [end, 0].map((n) => ({ x: frame.x(line.x[n]), y: frame.y(line.y[n]) }));
  const text = t("Gap {gap} ({share} of the distance)", { gap: lengthText(closing.gap_m), share: percentText(closing.share) });
  for (const [width, colour] of [[5, frame.ink.rim], [2.5, frame.ink.current]]) {
    pen.beginPath();
    pen.setLineDash([6, 5]);
    pen.moveTo(from.x, from.y);
    pen.lineTo(to.x, to.y);
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.stroke();
    pen.setLineDash([]);
  }
  if (!received) return;
  const [x, y] = [(from.x + to.x) / 2, (from.y + to.y) / 2];
  const offset = Math.hypot(from.x - to.x, from.y - to.y) < SMALL_GAP_PX ? 20 : 0;
  words(pen, frame, text, [x + 26, y + 4 + offset]);
}

function words(pen, { ink, size }, text, [x, y]) {
  pen.font = "600 13px system-ui, sans-serif";
  pen.textAlign = "start";
  pen.textBaseline = "middle";
  const edge = y > size.y - NORTH.height ? NORTH.width : 8;
  const left = Math.min(x, size.x - pen.measureText(text).width - edge);
  pen.lineWidth = 4;
  pen.strokeStyle = ink.halo;
  pen.strokeText(text, left, y);
  pen.fillStyle = ink.text;
  pen.fillText(text, left, y);
}

function newest(frame, { last }, line) {
  if (!last) return null;
  const flat = frame.ground.flat(last.lat, last.lon);
  if (!flat) return null;
  const heading = last.heading_deg ?? (line?.length ? line.headingAt(line.length - 1) : NaN);
  return { x: flat[0], y: flat[1], heading, covariance: last.covariance_m2 };
}

/**
 * Axes of the ellipse with 68 % of a two-dimensional normal distribution.
 * @param {number[]} covariance variance east, variance north, covariance of the two; square metres
 * @returns {{long: number, short: number, turn: number}} half axes, metres; direction of the long one, degrees clockwise from north
 */
export function ellipseOf([east, north, both]) {
  const [middle, half] = [(east + north) / 2, Math.hypot((east - north) / 2, both)];
  const axis = (variance) => WITHIN_68 * Math.sqrt(Math.max(variance, 0));
  return { long: axis(middle + half), short: axis(middle - half), turn: (Math.atan2(2 * both, north - east) * 90) / Math.PI };
}

/** The uncertainty of the last position; left out where the symbol of the robot hides it. */
function drawEllipse(pen, frame, { x, y, covariance }, colour) {
  const { long, short, turn } = ellipseOf(covariance);
  const [a, b] = [long / frame.metresPerPixel, Math.max(short / frame.metresPerPixel, 1)];
  if (!(a > ROBOT)) return;
  pen.beginPath();
  pen.ellipse(frame.x(x), frame.y(y), a, b, ((turn + frame.turn(x, y) - 90) * Math.PI) / 180, 0, 2 * Math.PI);
  shade(pen, colour);
}

function drawRobot(pen, frame, { x, y, heading }, { colour, label }) {
  const [sx, sy] = [frame.x(x), frame.y(y)];
  if (label) words(pen, frame, label, [sx + ROBOT + 8, sy]);
  pen.save();
  pen.translate(sx, sy);
  pen.beginPath();
  if (Number.isFinite(heading)) {
    pen.rotate(((heading + frame.turn(x, y)) * Math.PI) / 180);
    pen.moveTo(0, -ROBOT - 3);
    pen.lineTo(ROBOT - 2, ROBOT - 2);
    pen.lineTo(0, ROBOT - 6);
    pen.lineTo(2 - ROBOT, ROBOT - 2);
    pen.closePath();
  } else {
    pen.arc(0, 0, ROBOT - 3, 0, 2 * Math.PI);
  }
  for (const [width, ink] of [[6, frame.ink.robot], [3, "#ffffff"]]) {
    pen.lineWidth = width;
    pen.strokeStyle = ink;
    pen.stroke();
  }
  pen.fillStyle = colour;
  pen.fill();
  pen.restore();
}

function drawPointed(pen, frame, { x, y }) {
  for (const [width, colour] of [[6, frame.ink.rim], [3, frame.ink.current]]) {
    pen.beginPath();
    pen.arc(frame.x(x), frame.y(y), 9, 0, 2 * Math.PI);
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.stroke();
  }
}
