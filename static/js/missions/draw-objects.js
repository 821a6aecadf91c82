/** Detected objects as signs of their class; those that the filter leaves out, or that were seen later, are not shown. */

const RADIUS = 11;
const glyphs = new Map();

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Object} frame
 * @param {import("./mission-store.js").MissionStore} store
 * @returns {Array<{x: number, y: number, key: string}>} where they are on the screen
 */
export function drawObjects(pen, frame, store) {
  const spots = [];
  for (const object of store.objects.values()) {
    const mission = store.missions.get(object.mission);
    if (!mission || (store.matching && !store.matching.has(object.key))) continue;
    if (object.first_time_s > store.timeIn(mission)) continue;
    const at = frame.place(object.lat, object.lon);
    if (!at || at.x < -20 || at.y < -20 || at.x > frame.size.x + 20 || at.y > frame.size.y + 20) continue;
    spots.push({ ...at, key: object.key, kind: object.kind });
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

/** Where the chosen object was seen before. */
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

function sign(pen, { ink }, { x, y, kind }, { symbols }) {
  const { colour, ink: on, path, letter } = symbols.of(kind);
  pen.beginPath();
  pen.arc(x, y, RADIUS, 0, 2 * Math.PI);
  pen.fillStyle = colour;
  pen.fill();
  pen.lineWidth = 2;
  pen.strokeStyle = ink.rim;
  pen.stroke();
  if (!path) {
    pen.fillStyle = on;
    pen.font = "700 13px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(letter, x, y + 0.5);
    return;
  }
  if (!glyphs.has(path)) glyphs.set(path, new Path2D(path));
  pen.save();
  pen.translate(x - 7.5, y - 7.5);
  pen.scale(0.625, 0.625);
  pen.lineWidth = 2.4;
  pen.strokeStyle = on;
  pen.stroke(glyphs.get(path));
  pen.restore();
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
