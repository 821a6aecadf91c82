import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { clamped, Georeference, imageAngle, isInside, latLngOf, latLonText, pixelOf, roundLength, wholeTurn } = await import(
  "../../static/js/shared/map/coords.js"
);

const SATELLITE = { width: 400, height: 200 };
/** North is up: the height is one degree of latitude, the width two degrees of longitude. */
const NORTH_UP = { metres_per_pixel: 0.5, latlon_grid: { columns: 1, rows: 1, latlon: [[51, 14], [51, 16], [50, 14], [50, 16]] } };

const near = (found, wanted, tolerance = 1e-9) => {
  assert.equal(found.length, wanted.length);
  found.forEach((value, n) => assert.ok(Math.abs(value - wanted[n]) <= tolerance, `${found} is not ${wanted}`));
};

test("a pixel survives the way to Leaflet and back", () => {
  assert.deepEqual(latLngOf([30, 40]), { lat: -40, lng: 30 });
  assert.deepEqual(pixelOf(latLngOf([30, 40])), [30, 40]);
});

test("pixels outside are clamped to the image, with two decimals", () => {
  assert.deepEqual(clamped([-3, 250], SATELLITE), [0, 200]);
  assert.deepEqual(clamped([12.3456, 7.891], SATELLITE), [12.35, 7.89]);
  assert.ok(isInside([400, 200], SATELLITE));
  assert.ok(!isInside([400.1, 200], SATELLITE));
});

test("angles are wrapped into [0, 360)", () => {
  assert.equal(wholeTurn(-90), 270);
  assert.equal(wholeTurn(359.96), 0);
  assert.equal(wholeTurn(725.56), 5.6);
});

test("image angles are clockwise from up", () => {
  assert.equal(imageAngle([0, 0], [0, -5]), 0);
  assert.equal(imageAngle([0, 0], [5, 0]), 90);
  assert.equal(imageAngle([0, 0], [0, 5]), 180);
});

test("positions are interpolated between the samples of the grid", () => {
  const georeference = new Georeference(NORTH_UP, SATELLITE);
  near(georeference.latLon([0, 0]), [51, 14]);
  near(georeference.latLon([200, 50]), [50.75, 15]);
  near(georeference.latLon([400, 200]), [50, 16]);
  assert.ok(Math.abs(georeference.north([200, 100])) < 1e-9);
});

test("north of a turned image", () => {
  const quarter = { metres_per_pixel: 1, latlon_grid: { columns: 1, rows: 1, latlon: [[0, 0], [-1, 0], [0, -1], [-1, -1]] } };
  const square = { width: 100, height: 100 };
  near([new Georeference(quarter, square).north([50, 50])], [-90], 0.01);
});

test("longitudes across the date line stay in range", () => {
  const across = { metres_per_pixel: 1, latlon_grid: { columns: 1, rows: 1, latlon: [[1, 179], [1, 181], [0, 179], [0, 181]] } };
  near(new Georeference(across, SATELLITE).latLon([400, 0]), [1, -179]);
});

test("without a georeference there are no positions", () => {
  const none = new Georeference(null, SATELLITE);
  assert.equal(none.latLon([1, 1]), null);
  assert.equal(none.north([1, 1]), 0);
  assert.equal(none.metresPerPixel, null);
});

test("latitude and longitude are written with their hemispheres", () => {
  assert.equal(latLonText([50.0875, 14.4213]), "50.087500° N, 14.421300° E");
  assert.equal(latLonText([-33.9, -70]), "33.900000° S, 70.000000° W");
});

test("scale bars have round lengths that are not longer than the room", () => {
  assert.deepEqual([1, 1.9, 2, 4.9, 7, 99, 0.3].map(roundLength), [1, 1, 2, 2, 5, 50, 0.2]);
});
