import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { drawMarks, ellipseOf } = await import("../../static/js/missions/draw-marks.js");

const near = (found, expected) => assert.ok(Math.abs(found - expected) < 1e-6, `${found} is not ${expected}`);

test("the ellipse of a position has 68 % of the distribution, and its long axis where the variance is largest", () => {
  const within = Math.sqrt(-2 * Math.log(1 - 0.68)); // of a normal distribution in the plane
  const { long, short, turn } = ellipseOf([9, 36, 0]);
  assert.ok(Math.abs(long - 6 * within) < 0.01 && Math.abs(short - 3 * within) < 0.01);
  near(turn, 0);
  near(ellipseOf([36, 9, 0]).turn, 90);
  near(ellipseOf([20, 20, 5]).turn, 45); // to the north-east
  near(ellipseOf([20, 20, -5]).turn, -45);
  near(ellipseOf([4, 4, 4]).short, 0);
});

/** Records the ellipses that are drawn at the last position of a track. */
function ellipses(covariance, { moment = null, metresPerPixel = 0.1, source = "gps" } = {}) {
  const drawn = [];
  const ignore = () => {};
  const pen = new Proxy({ ellipse: (...values) => drawn.push(values) }, { get: (target, name) => target[name] ?? ignore, set: () => true });
  const frame = {
    ground: { flat: (lat, lon) => [lon, -lat] }, ink: {}, size: { x: 900, y: 500 }, metresPerPixel,
    x: (x) => x, y: (y) => y, turn: () => 30, place: () => null,
  };
  const track = { source, last: { lat: 50, lon: 14, heading_deg: 10, covariance_m2: covariance } };
  const mission = { id: 1, name: "one", tracks: [track] };
  const store = { missions: new Map([[1, mission]]), mission, moment, fixes: [], shown: [{ mission, track, key: "1/1" }], timeIn: () => 5 };
  drawMarks(pen, frame, { store, lines: { best: () => null, at: () => ({ x: 14, y: -50, heading: 10 }) }, hover: null });
  return drawn;
}

test("it is drawn at the last position, turned with the image, where it is larger than the robot", () => {
  const [[x, y, long, short, angle]] = ellipses([9, 36, 0]);
  assert.deepEqual([x, y], [14, -50]);
  assert.ok(Math.abs(long - 90.6) < 0.01 && Math.abs(short - 45.3) < 0.01);
  near(angle, (-60 * Math.PI) / 180);
  assert.deepEqual(ellipses([9, 36, 0], { metresPerPixel: 1 }), []);
  assert.deepEqual(ellipses(null), []);
  assert.deepEqual(ellipses([9, 36, 0], { moment: 3 }), []); // an earlier moment: its covariance is not known
  assert.deepEqual(ellipses([9, 36, 0], { source: "visual" }), []); // has its own circles
});
