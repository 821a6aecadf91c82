import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { duration, t, tn } = await import("../../static/js/shared/i18n.js");
const { headingText, isLoopback, leftText, lengthText, metresText, numberText, sizeText, percentText } = await import("../../static/js/shared/format.js");
const { probabilityColours } = await import("../../static/js/shared/answer/answer-format.js");
const missions = await import("../../static/js/missions/format.js");

test("known texts are translated, others stay, and values are filled in", () => {
  assert.equal(t("Hello"), "Ahoj");
  assert.equal(t("{a} of {b}, {c}", { a: 1, b: "$&" }), "1 of $&, {c}");
  assert.equal(tn("{n} photo", "{n} photos", 1), "1 fotka");
  assert.equal(tn("{n} photo", "{n} photos", 1200), "1,200 fotek");
  assert.equal(tn("{n} dot", "{n} dots", 1), "1 dot");
  assert.equal(tn("{n} dot", "{n} dots", 0), "0 dots");
});

test("durations are rounded to what matters", () => {
  assert.deepEqual([0, 89, 90, 5399, 5400].map(duration), ["1 second", "89 seconds", "2 minutes", "90 minutes", "2 hours"]);
  assert.equal(leftText(59), "59 seconds left");
});

test("sizes and lengths carry sensible digits", () => {
  assert.deepEqual([5, 1500, 2_500_000, 25_000_000, 3e9].map(sizeText), ["0.1 kB", "1.5 kB", "2.5 MB", "25 MB", "3 GB"]);
  assert.deepEqual([0.0004, 0.1234, 12.345, 1234].map(metresText), ["0", "0.123", "12.3", "1,230"]);
  assert.equal(lengthText(null, 7.25), "7.3 px");
  assert.equal(lengthText(3.14159, 99), "3.1 m");
  assert.equal(lengthText(31.4, 99), "31 m");
  assert.equal(numberText(1234.5), "1,235");
});

test("addresses of the computer itself are known", () => {
  const hosts = ["127.0.0.1:8000", "localhost", "map.localhost:80", "[::1]:8000", "192.168.1.5", "127.example.org", "localhost.org"];
  assert.deepEqual(hosts.map((host) => isLoopback(`http://${host}/s/x`)), [true, true, true, true, false, false, false]);
});

test("a probability that is neither 0 nor 1 is never written as 0 % or 100 %", () => {
  const texts = [0, 0.001, 0.5, 0.994, 0.9951, 1].map((p) => percentText(p).replace("\u00a0", " "));
  assert.deepEqual(texts, ["0 %", "< 1 %", "50 %", "> 99 %", "> 99 %", "100 %"]);
});

test("colours are looked up by percent, within 0 and 100", () => {
  assert.deepEqual(probabilityColours(0.426), { fill: "fill 43", text: "text 43" });
  assert.equal(probabilityColours(1.2).fill, "fill 100");
  assert.equal(probabilityColours(-1).fill, "fill 0");
});

test("headings name their direction", () => {
  assert.deepEqual([0, 44, 359.7, -90].map(headingText), ["0° (north)", "44° (north-east)", "0° (north)", "270° (west)"]);
});

test("times of missions", () => {
  assert.deepEqual([0, 61, 3600 + 62.4].map(missions.spanText), ["0:00", "1:01", "1:01:02"]);
  assert.deepEqual([3.456, 34.56, 345.6, 3456, 34560].map(missions.lengthText), ["3.46 m", "34.6 m", "346 m", "3.46 km", "34.6 km"]);
  assert.equal(missions.trackName({ source: "gps", name: "left" }), "GPS · left");
});

test("a length of any size has its three first digits", () => {
  for (let power = -3; power < 8; power += 1) {
    for (let n = 0; n < 1000; n += 7) {
      const value = (1 + n * 0.008999) * 10 ** power;
      const shown = Number(metresText(value).replaceAll(",", ""));
      assert.ok(Math.abs(shown - value) <= 0.0051 * value, `${value} is shown as ${metresText(value)}`);
    }
  }
});
