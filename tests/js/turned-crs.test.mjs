import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

globalThis.L.point = (x, y) => ({ x, y });
globalThis.L.Projection = { LonLat: {} };
globalThis.L.CRS.Simple = { infinite: true };

const { Turn, turnableCrs, turnOf, UPRIGHT } = await import("../../static/js/shared/map/turned-crs.js");
const { latLngOf, pixelOf } = await import("../../static/js/shared/map/coords.js");
const { northOf } = await import("../../static/js/shared/map/north-up.js");
const { Georeference } = await import("../../static/js/shared/map/coords.js");

const ANGLES = [0, 30, 90, 180, -135];
const PIXELS = [[0, 0], [4000, 0], [0, 3000], [1234.5, 678.25], [-20, 9000]];
const near = (found, wanted, tolerance = 1e-6) => {
  assert.equal(found.length, wanted.length);
  found.forEach((value, n) => assert.ok(Math.abs(value - wanted[n]) <= tolerance, `${found} is not ${wanted}`));
};

for (const degrees of ANGLES) {
  test(`pixels go through the projection and back, turned by ${degrees} degrees`, () => {
    const crs = turnableCrs();
    crs.turn = new Turn(degrees);
    for (const pixel of PIXELS) {
      const drawn = crs.projection.project(latLngOf(pixel));
      near(pixelOf(crs.projection.unproject(drawn)), pixel);
      near([drawn.x, -drawn.y], new Turn(degrees).forth(pixel));
    }
  });

  test(`an image is turned by ${degrees} degrees without being scaled`, () => {
    const turn = new Turn(degrees);
    const [from, to] = [turn.forth([10, 20]), turn.forth([310, 420])];
    assert.ok(Math.abs(Math.hypot(to[0] - from[0], to[1] - from[1]) - 500) < 1e-9);
    near(turn.back(turn.forth([310, 420])), [310, 420]);
  });
}

test("a turn is clockwise on a screen with y down", () => {
  near(new Turn(90).forth([0, -1]), [1, 0]);
  near(new Turn(30).forth([0, -1]), [Math.sin(Math.PI / 6), -Math.cos(Math.PI / 6)]);
});

test("the rectangle around a turned image", () => {
  const around = (degrees) => new Turn(degrees).around([0, 0], [400, 200]);
  near(around(0), [0, 0, 400, 200]);
  near(around(90), [-200, 0, 0, 400]);
  near(around(180), [-400, -200, 0, 0]);
  const [left, top, right, bottom] = around(30);
  near([right - left, bottom - top], [400 * Math.cos(Math.PI / 6) + 100, 200 * Math.cos(Math.PI / 6) + 200]);
  const half = Math.SQRT1_2;
  const [l, t, r, b] = around(-135);
  near([r - l, b - t], [600 * half, 600 * half]);
});

test("what is drawn around a view holds the view of the image", () => {
  const turn = new Turn(35);
  const [left, top, right, bottom] = turn.around([100, 50], [500, 300], "back");
  for (const corner of [[100, 50], [500, 50], [500, 300], [100, 300]].map((one) => turn.back(one))) {
    assert.ok(corner[0] >= left - 1e-9 && corner[0] <= right + 1e-9 && corner[1] >= top - 1e-9 && corner[1] <= bottom + 1e-9);
  }
});

test("a map without a turn of its own is upright", () => {
  assert.equal(turnOf({ options: { crs: globalThis.L.CRS.Simple } }), UPRIGHT);
  assert.equal(turnOf({ options: { crs: turnableCrs() } }), UPRIGHT);
});

/** A map of 400 x 400 px at the equator, with north rotated clockwise from image-up. */
function turnedMap(north) {
  const satellite = { width: 400, height: 400 };
  const place = (x, y) => {
    const [east, south] = new Turn(-north).forth([x, y]);
    return [-south * 1e-5, 14 + east * 1e-5];
  };
  const grid = { columns: 1, rows: 1, latlon: [place(0, 0), place(400, 0), place(0, 400), place(400, 400)] };
  return { satellite, georeference: new Georeference({ metres_per_pixel: 1, latlon_grid: grid }, satellite) };
}

test("north is known where the image has it, and ignored below one degree", () => {
  for (const north of [30, 90, -135, 35.5]) near([northOf(turnedMap(north))], [north], 1e-3);
  assert.equal(northOf(turnedMap(0.9)), 0);
  assert.equal(northOf({ satellite: null, georeference: new Georeference(null, null) }), 0);
  assert.equal(northOf({ satellite: { width: 10, height: 10 }, georeference: new Georeference(null, { width: 10, height: 10 }) }), 0);
});

test("north is up once the image is turned back by where north is", () => {
  const { satellite, georeference } = turnedMap(35);
  const turn = new Turn(-northOf({ satellite, georeference }));
  const middle = [200, 200];
  const north = (35 * Math.PI) / 180;
  const [[x, y], [toX, toY]] = [middle, [200 + 50 * Math.sin(north), 200 - 50 * Math.cos(north)]].map((pixel) => turn.forth(pixel));
  near([toX - x, toY - y], [0, -50], 1e-2);
  assert.ok(georeference.latLon([200 + 50 * Math.sin(north), 200 - 50 * Math.cos(north)])[0] > georeference.latLon(middle)[0]);
});
