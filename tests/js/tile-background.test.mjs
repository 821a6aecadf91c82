import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { Affine, mercator, pixelsFromMercator, tilesInView } = await import("../../static/js/shared/map/tile-background.js");
const { Georeference } = await import("../../static/js/shared/map/coords.js");

const SATELLITE = { width: 400, height: 400 };
/** A square of web Mercator at (50 N, 14 E), rotated by 30 degrees and so small that it is nearly affine. */
const [CENTRE, HALF, TURN] = [[50, 14], 0.001, Math.PI / 6];
const corner = (x, y) => {
  const [east, north] = [x * Math.cos(TURN) - y * Math.sin(TURN), x * Math.sin(TURN) + y * Math.cos(TURN)];
  return [CENTRE[0] + north * HALF * Math.cos((CENTRE[0] * Math.PI) / 180), CENTRE[1] + east * HALF];
};
const latlon = [corner(-1, 1), corner(1, 1), corner(-1, -1), corner(1, -1)];
const georeference = new Georeference({ metres_per_pixel: 0.5, latlon_grid: { columns: 1, rows: 1, latlon } }, SATELLITE);
const near = (found, wanted, tolerance) => found.forEach((value, n) => assert.ok(Math.abs(value - wanted[n]) <= tolerance, `${found} is not ${wanted}`));

test("the world is the unit square", () => {
  near(mercator([0, 0]), [0.5, 0.5], 1e-12);
  near(mercator([85.0511, -180]), [0, 0], 1e-4);
  near(mercator([90, 180]), [1, mercator([85.05, 0])[1]], 1e-12);
  near(mercator([50, 14]), [0.5388888889, 0.3391447746], 1e-9);
});

test("an affine function and its inverse", () => {
  const affine = new Affine([2, 1, -1, 3], [10, -4]);
  near(affine.apply([1, 2]), [14, 1], 1e-12);
  near(affine.inverse().apply(affine.apply([7, -3])), [7, -3], 1e-12);
});

test("positions on the Earth are on the pixels that the georeference gives them", () => {
  const toPixels = pixelsFromMercator(georeference, [200, 200], 150);
  for (const pixel of [[200, 200], [0, 0], [400, 100], [-300, 650]]) {
    near(toPixels.apply(mercator(georeference.latLon(pixel))), pixel, 0.02);
  }
});

test("without positions there is nothing to draw on", () => {
  assert.equal(pixelsFromMercator(new Georeference(null, SATELLITE), [200, 200], 100), null);
  const holes = { metres_per_pixel: 0.5, latlon_grid: { columns: 1, rows: 1, latlon: [...latlon.slice(0, 3), null] } };
  assert.equal(pixelsFromMercator(new Georeference(holes, SATELLITE), [200, 200], 100), null);
});

test("a turned view asks for the tiles that it meets, and for no others", () => {
  const size = { x: 512, y: 256 };
  const half = Math.SQRT1_2;
  const toView = ([x, y]) => [256 * (x * half - y * half) + 256, 256 * (x * half + y * half) + 128];
  const toTile = ([u, v]) => [((u - 256) * half + (v - 128) * half) / 256, ((v - 128) * half - (u - 256) * half) / 256];
  const corners = [[0, 0], [512, 0], [512, 256], [0, 256]].map(toTile);
  const found = tilesInView(toView, corners, size);
  const seen = new Set();
  for (let u = 1; u < 512; u += 3) for (let v = 1; v < 256; v += 3) seen.add(String(toTile([u, v]).map(Math.floor)));
  for (const tile of seen) assert.ok(found.some((one) => String(one) === tile), `${tile} is missing`);
  assert.ok(found.length <= seen.size + 2, `${found.length} tiles for ${seen.size}`);
  assert.deepEqual(tilesInView(toView, corners.map(([x, y]) => [x * 100, y * 100]), size), [], "no view needs thousands");
});
