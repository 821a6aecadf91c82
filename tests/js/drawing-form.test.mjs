import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

let chosen = null;
globalThis.localStorage = /** @type {*} */ ({ getItem: () => chosen });
const inForm = (form) => {
  chosen = form;
  return import(`../../static/js/missions/drawings/drawing-form.js`);
};

const CORNERS = /** @type {Array<[number, number]>} */ ([[50.21040012, 15.82520034], [50.2106, 15.8262], [50.2101, 15.8268]]);
const { pointsOf, pointsText } = await inForm("mgrs");

test("points are shown in the chosen notation, and unchanged ones stay as exact as they were", () => {
  const text = pointsText(CORNERS);
  assert.match(text, /^33U WR \d{5} \d{5}\n33U WR/);
  assert.deepEqual(pointsOf(text, CORNERS), { points: CORNERS, wrong: null });
  const [first] = pointsOf(text).points; // read from the text alone: to a metre
  assert.ok(Math.abs(first[0] - CORNERS[0][0]) < 1e-5 && Math.abs(first[1] - CORNERS[0][1]) < 2e-5);
});

test("points are typed in any notation, one in each line", () => {
  const { points, wrong } = pointsOf("50.2104, 15.8252\n\n 50°12'37.44\"N 15°49'30.72\"E \n33U 558900 5562300", []);
  assert.equal(wrong, null);
  assert.deepEqual(points[0], [50.2104, 15.8252]);
  assert.equal(points.length, 3);
  for (const [lat, lon] of points) assert.ok(Math.abs(lat - 50.21) < 0.01 && Math.abs(lon - 15.825) < 0.01, `${lat} ${lon}`);
});

test("the line that is not a position is named", () => {
  assert.equal(pointsOf("50.2104, 15.8252\n50.2", []).wrong, "50.2");
});
