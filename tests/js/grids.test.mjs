import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { dmsText, mgrsText, parsePosition, utmOf, utmText } = await import("../../static/js/shared/map/grids.js");

/** As converted by other programs, which round or truncate the metres; those of `tests/core/geo/test_grids.py`. */
const KNOWN = [
  [[42.0, -93.0], "15T WG 00000 49776"],
  [[48.24949, 16.4145], "33U XP 05004 44998"],
  [[48.8581938379, 2.2944892452], "31U DQ 48251 11932"],
  [[-33.90772474, 151.21288644], "56H LH 34775 46637"],
  [[83.62738, -32.66433], "25X EN 04159 86508"],
];

test("MGRS of known places", () => {
  for (const [place, expected] of KNOWN) {
    const [found, known] = [mgrsText(place), expected].map((text) => text.split(" "));
    assert.deepEqual(found.slice(0, 2), known.slice(0, 2));
    for (const n of [2, 3]) assert.ok(Math.abs(Number(found[n]) - Number(known[n])) <= 1, `${found} is not ${known}`);
  }
});

test("zones with the exceptions of Norway and Svalbard, and across the antimeridian", () => {
  const zones = [
    [60.39, 5.32, 32, "V"], [55.9, 5.32, 31, "U"], [78.2, 15.6, 33, "X"], [78.2, 8.9, 31, "X"], [78.2, 9, 33, "X"], [78.2, 35, 37, "X"],
    [0, 0, 31, "N"], [-0.0001, 0, 31, "M"], [84, 0, 31, "X"], [-80, -180, 1, "C"], [10, 180, 1, "P"], [10, 179.999, 60, "P"], [10, 190, 2, "P"],
  ];
  for (const [lat, lon, zone, band] of zones) {
    const found = utmOf([lat, lon]);
    assert.deepEqual([found.zone, found.band], [zone, band], `${lat}, ${lon}`);
  }
});

test("near the poles there is no UTM", () => {
  for (const lat of [84.01, 90, -80.01, -90, NaN]) {
    assert.equal(utmText([lat, 10]), null);
    assert.equal(mgrsText([lat, 10]), null);
  }
});

test("degrees, minutes and seconds carry", () => {
  assert.equal(dmsText([50.2104, 15.8252]), "50°12'37.44\"N 15°49'30.72\"E");
  assert.equal(dmsText([-0.5, -179.9999999]), "0°30'00.00\"S 180°00'00.00\"W");
  assert.equal(dmsText([9.99999999, 0]), "10°00'00.00\"N 0°00'00.00\"E");
});

test("what the page writes is read as the same place", () => {
  const places = [[50.0875, 14.4213], [-33.90772, 151.21288], [60.39, 5.32], [78.2, 15.6], [-0.0001, -0.0001], [83.9, -179.99], [-79.9, 179.99], [71.999, 41]];
  for (const [lat, lon] of places) {
    for (const write of [dmsText, utmText, mgrsText]) {
      const text = write([lat, lon]);
      const found = parsePosition(text);
      assert.ok(found, text);
      const metres = Math.hypot(found[0] - lat, (found[1] - lon) * Math.cos((lat * Math.PI) / 180)) * 111_320;
      assert.ok(metres < 1.5, `${text} is read ${metres} m away`);
    }
    assert.equal(mgrsText(parsePosition(mgrsText([lat, lon]))), mgrsText([lat, lon]));
  }
});

test("positions as people write them", () => {
  const near = (text, [lat, lon]) => {
    const found = parsePosition(text);
    assert.ok(found && Math.abs(found[0] - lat) < 2e-5 && Math.abs(found[1] - lon) < 2e-5, `${text} is read as ${found}`);
  };
  near("50.0875, 14.4213", [50.0875, 14.4213]);
  near("-33.9 151.2", [-33.9, 151.2]);
  near("33.900000° S, 151.200000° E", [-33.9, 151.2]);
  near("50° 12′ 37.44″ n, 15° 49′ 30.72″ w", [50.2104, -15.8252]);
  near("31U DQ 48251 11932", [48.85819, 2.29449]);
  near("31udq4825111932", [48.85819, 2.29449]);
  near("31U 448251 5411932", [48.85819, 2.29449]);
  near("31N 448251 5411932", [48.85819, 2.29449]); // N: the hemisphere, as the band N is at the equator
  near("56S 334775 6246637", [-33.90772, 151.21288]); // S: the hemisphere
  const wide = parsePosition("31U DQ 48 11"); // a square of a kilometre: its middle
  assert.equal(mgrsText(wide), "31U DQ 48500 11500");
});

test("what is no position is refused", () => {
  const wrong = ["", "50", "95, 10", "10, 181", "1, 2, 3", "somewhere", "61U 448251 5411932", "31U DQ 48251 1193", "31I DQ 48 11", "31U 448251 100", "31U JQ 48 11", "0A", "50°61'00\"N 15°00'00\"E"];
  for (const text of wrong) assert.equal(parsePosition(text), null, text);
});
