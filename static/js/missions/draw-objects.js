/** Detected objects as symbols of their class; those filtered out or seen only later are not shown. */

import { isOpen } from "./object-states.js";

const RADIUS = 13;
const INK = "#14181a";
/** Opacity of objects that are done. */
const DONE_ALPHA = 0.45;
const paths = new Map();

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Object} frame
 * @param {import("./mission-store.js").MissionStore} store
 * @returns {Array<{x: number, y: number, key: string}>} positions on the screen
 */
export function drawObjects(pen, frame, store) {
  const spots = [];
  for (const object of store.objects.values()) {
    const mission = store.missions.get(object.mission);
    if (!mission || (store.matching && !store.matching.has(object.key))) continue;
    if (object.first_time_s > store.timeIn(mission)) continue;
    const at = frame.place(object.lat, object.lon);
    if (!at || at.x < -20 || at.y < -20 || at.x > frame.size.x + 20 || at.y > frame.size.y + 20) continue;
    spots.push({ ...at, key: object.key, kind: object.kind, open: isOpen(object) });
  }
  drawTrail(pen, frame, store.trail);
  for (const spot of spots) if (spot.key !== store.chosen) sign(pen, frame, spot, store);
  const chosen = spots.find(({ key }) => key === store.chosen);
  if (chosen) {
    ring(pen, chosen, frame.ink);
    sign(pen, frame, chosen, store);
  }
  return spots;
}

/** Draw the earlier positions of the chosen object. */
function drawTrail(pen, frame, trail) {
  const places = trail.map(({ lat, lon }) => frame.place(lat, lon)).filter(Boolean);
  if (places.length < 2) return;
  for (const [width, colour] of [[5, frame.ink.rim], [2.5, frame.ink.current]]) {
    pen.beginPath();
    for (const { x, y } of places) pen.lineTo(x, y);
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.stroke();
  }
}

function sign(pen, { ink }, { x, y, kind, open }, { symbols }) {
  const { colour, ink: on, frame, glyph, letter } = symbols.of(kind);
  pen.save();
  pen.globalAlpha = open ? 1 : DONE_ALPHA;
  pen.translate(x - RADIUS, y - RADIUS);
  pen.scale(RADIUS / 16, RADIUS / 16);
  pen.lineJoin = pen.lineCap = "round";
  stroke(pen, frame, { colour: ink.rim, width: 5 });
  pen.fillStyle = colour;
  pen.fill(pathOf(frame));
  stroke(pen, frame, { colour: INK, width: 2 });
  if (glyph) stroke(pen, glyph, { colour: on, width: 2.2 });
  else {
    pen.fillStyle = on;
    pen.font = "700 18px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(letter, 16, 16.5);
  }
  pen.restore();
}

function stroke(pen, path, { colour, width }) {
  pen.lineWidth = width;
  pen.strokeStyle = colour;
  pen.stroke(pathOf(path));
}

function pathOf(text) {
  if (!paths.has(text)) paths.set(text, new Path2D(text));
  return paths.get(text);
}

function ring(pen, { x, y }, ink) {
  for (const [width, colour] of [[6, ink.rim], [3, ink.current]]) {
    pen.beginPath();
    pen.arc(x, y, RADIUS + 5, 0, 2 * Math.PI);
    pen.lineWidth = width;
    pen.strokeStyle = colour;
    pen.stroke();
  }
}
