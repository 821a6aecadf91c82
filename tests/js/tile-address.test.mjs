import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { addressOf, areas } = await import("../../static/js/shared/map/tile-address.js");
const PRAGUE = { z: 12, x: 2212, y: 1387 };
const near = (text, wanted) => text.split(",").forEach((value, n) => assert.ok(Math.abs(Number(value) - wanted[n]) < 1e-6, `${text} is not ${wanted}`));

test("a tile is named by zoom, column and row", () => {
  assert.equal(addressOf("https://a.test/{z}/{y}/{x}?k={z}", PRAGUE), "https://a.test/12/1387/2212?k=12");
});

test("or by its area, west and south first in web Mercator", () => {
  near(addressOf("{bbox}", PRAGUE), bounds);
  assert.equal(addressOf("https://a.test/?BBOX={bbox}", { z: 0, x: 0, y: 0 }), "https://a.test/?BBOX=-20037508.342789244,-20037508.342789244,20037508.342789244,20037508.342789244");
});

test("or in degrees, south and west first, as the axes of EPSG:4326 are", () => {
  near(addressOf("{bbox-4326}", PRAGUE), [50.0641917367, 14.4140625, 50.1205780980, 14.501953125]);
});

test("Leaflet gets the same from its options", () => {
  assert.equal(areas.bbox(PRAGUE), addressOf("{bbox}", PRAGUE));
});

/** Of the tile, by its definition: the world is a square of 2 * pi * 6378137 m. */
const side = (2 * Math.PI * 6378137) / 4096;
const bounds = [2212 * side - 2048 * side, 2048 * side - 1388 * side, 2213 * side - 2048 * side, 2048 * side - 1387 * side];
