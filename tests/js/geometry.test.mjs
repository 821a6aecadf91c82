import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { Georeference, onScreen, panInto } = await import("../../static/js/shared/map/coords.js");
const { inkOn, SCALE, stepOf, STEPS } = await import("../../static/js/missions/colour-scales.js");
const { PixelFromLatLon } = await import("../../static/js/shared/map/latlon-to-pixel.js");
const { metresBetween, TrackPoints } = await import("../../static/js/missions/track-points.js");
const { cut } = await import("../../static/js/satellite/mercator.js");
const { usable } = await import("../../static/js/shared/drop-files.js");

const flat = { flat: (lat, lon) => [lon * 10, -lat * 10] };
const SIZE = { width: 300, height: 200 };

/** A curved grid: pixels are not an affine function of latitude and longitude. */
function bent(columns = 8, rows = 8) {
  const latlon = [];
  for (let j = 0; j <= rows; j += 1) {
    for (let i = 0; i <= columns; i += 1) {
      const [u, v] = [i / columns, j / rows];
      latlon.push([50 - 0.01 * v + 0.0005 * u * u, 14 + 0.02 * u + 0.0004 * u * v]);
    }
  }
  return new Georeference({ metres_per_pixel: 5, latlon_grid: { columns, rows, latlon } }, SIZE);
}

test("the pixel of a latitude and longitude is the inverse of the grid", () => {
  const georeference = bent();
  const inverse = new PixelFromLatLon(georeference);
  for (const pixel of [[0, 0], [150, 100], [299, 3], [37, 181]]) {
    const [x, y] = inverse.find(...georeference.latLon(pixel));
    assert.ok(Math.hypot(x - pixel[0], y - pixel[1]) < 0.1, `${pixel} became ${[x, y]}`);
  }
});

test("without a georeference there is no pixel", () => {
  assert.equal(new PixelFromLatLon(new Georeference(null, SIZE)).find(50, 14), null);
});

test("a track is interpolated in time, and points that are known are passed over", () => {
  const track = new TrackPoints({ points: [[0, 100, 0, 0, 90], [1, 110, 0, 1, null], [2, 120, 1, 1, null]], gaps: [] }, flat);
  track.append([[2, 120, 9, 9, 9], [3, 130, 2, 1, null]]);
  assert.equal(track.length, 4);
  assert.equal(track.at(99), null);
  assert.deepEqual([track.at(105).lat, track.at(105).lon, track.at(105).x], [0, 0.5, 5]);
  assert.equal(track.at(500).lat, 2);
  assert.equal(track.indexAt(110), 1);
});

test("a heading that is unknown is the direction to the next point", () => {
  const track = new TrackPoints({ points: [[0, 0, 0, 0, 123], [1, 1, 0, 1, null], [2, 2, 1, 1, null]], gaps: [] }, flat);
  assert.equal(track.headingAt(0), 123);
  assert.ok(Math.abs(track.headingAt(1)) < 1e-9);
});

test("no speed and no line across a gap", () => {
  const track = new TrackPoints({ points: [[0, 0, 0, 0, null], [1, 10, 0, 1, null]], gaps: [1] }, flat);
  assert.ok(Number.isNaN(track.speed[1]));
  assert.equal(track.at(5).gap, Infinity);
});

test("a track that is laid on another background keeps its points", () => {
  const track = new TrackPoints({ points: [[0, 0, 1, 2, null]], gaps: [] }, flat);
  track.setGround({ flat: () => null });
  assert.equal(track.length, 1);
  assert.ok(Number.isNaN(track.x[0]));
});

test("a degree of latitude is 111 km, one of longitude shrinks towards the poles", () => {
  assert.ok(Math.abs(metresBetween([0, 0], [1, 0]) - 111195) < 1);
  assert.ok(Math.abs(metresBetween([60, 0], [60, 1]) - 55597) < 10);
});

test("an area of tiles is cut to whole pixels", () => {
  const all = cut({ north: 85.0511287798, south: -85.0511287798, west: -180, east: 180 }, 1);
  assert.deepEqual([all.width, all.height, all.tiles], [512, 512, 4]);
  const across = cut({ north: 1, south: -1, west: 179, east: -179 }, 4);
  assert.ok(across.width > 0 && across.width < 40);
  const tiny = cut({ north: 10, south: 10, west: 10, east: 10 }, 3);
  assert.deepEqual([tiny.width, tiny.height, tiny.tiles], [1, 1, 1]);
});

test("values are put on the colour scale, those outside at its ends", () => {
  assert.equal(SCALE.length, STEPS);
  assert.deepEqual([stepOf(-1, [0, 1]), stepOf(0.5, [0, 1]), stepOf(9, [0, 1]), stepOf(3, [3, 3])], [0, STEPS / 2, STEPS - 1, 0]);
  assert.equal(inkOn("#ffffff"), "#14181a");
  assert.equal(inkOn("#440154"), "#ffffff");
});

test("files that file managers leave behind are not uploaded", () => {
  const names = ["a.jpg", ".DS_Store", "Thumbs.db", "._b.jpg", "desktop.ini"];
  assert.deepEqual(usable(names.map((name) => ({ name }))).map(({ name }) => name), ["a.jpg"]);
});

test("a place is revealed in the part of a map that is on the screen", () => {
  const map = { left: 0, top: 570, right: 390, bottom: 890 }; // a phone of 844 pixels shows the upper 274
  assert.deepEqual(onScreen(map, 844), { left: 0, top: 0, right: 390, bottom: 274 });
  assert.deepEqual(onScreen({ ...map, top: -100, bottom: 220 }, 844), { left: 0, top: 100, right: 390, bottom: 320 });
  assert.deepEqual(onScreen({ ...map, top: 900, bottom: 1220 }, 844), { left: 0, top: 0, right: 390, bottom: 320 }, "below the screen");
  const part = onScreen(map, 844);
  assert.deepEqual(panInto({ x: 200, y: 150 }, part, 40), [0, 0]);
  assert.deepEqual(panInto({ x: 200, y: 300 }, part, 40), [0, 163], "only up");
  assert.deepEqual(panInto({ x: 380, y: 10 }, part, 40), [185, -127]);
  assert.deepEqual(panInto({ x: 200, y: 45 }, { ...part, bottom: 90 }, 70), [0, 0], "the margin leaves a third");
});
