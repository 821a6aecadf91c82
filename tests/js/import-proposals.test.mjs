import assert from "node:assert/strict";
import { test } from "node:test";

import { coveringMap, titleOf } from "../../static/js/missions/import/proposals.js";

const map = (slug, south, west, north, east) => ({ slug, box: /** @type {[number, number, number, number]} */ ([south, west, north, east]) });
const MAPS = [map("country", 48, 12, 51, 19), map("park", 50, 14, 50.1, 14.1), map("yard", 50, 14, 50.01, 14.01), { slug: "plan", box: null }];
const walk = (south, west, north, east) => ({ frame: "earth", extent: { south, west, north, east } });

test("the smallest map that holds the whole walk is proposed", () => {
  assert.equal(coveringMap(MAPS, [walk(50.001, 14.001, 50.002, 14.002)]).slug, "yard");
  assert.equal(coveringMap(MAPS, [walk(50.001, 14.001, 50.02, 14.002)]).slug, "park");
  assert.equal(coveringMap(MAPS, [walk(50.001, 14.001, 50.002, 14.002), walk(49, 13, 49.1, 13.1)]).slug, "country");
});

test("no map is proposed for a walk that leaves all, or for tracks in metres only", () => {
  assert.equal(coveringMap(MAPS, [walk(50.001, 14.001, 52, 14.002)]), null);
  assert.equal(coveringMap(MAPS, [{ frame: "robot", extent: { x: 1, y: 1, z: 0 } }]), null);
});

test("a mission is named after the only track of a file, or else after the file", () => {
  const named = (...tracks) => titleOf({ name: "2026-05-01.gpx", contents: { sources: tracks.map((track) => ({ track })) } });
  assert.equal(named("track 1 To the mill"), "To the mill");
  assert.equal(named("track 1 To the mill", "track 2 And back"), "2026-05-01");
  assert.equal(named("track 1"), "2026-05-01");
  assert.equal(named(""), "2026-05-01");
  assert.equal(titleOf({ name: ".gpx", contents: null }), ".gpx");
});
