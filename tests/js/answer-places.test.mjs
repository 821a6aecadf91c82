import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";

import "./page.mjs";

import { placesOf } from "../../static/js/shared/answer/answer-places.js";
import { isOffMap, QuerySession, ranking, verdictOf } from "../../static/js/shared/answer/query-session.js";

const { isFaint, isMinor, verdictText } = await import("../../static/js/shared/answer/verdict.js");

const hypothesis = (rank, probability, fields = {}) => ({ rank, probability, x_px: rank, y_px: rank, radius_px: 5, heading_deg: null, experiences: [rank], ...fields });
const exact = { placement: null, position: () => null };
const rooms = { placement: "rooms", position: (id) => ({ 1: [10, 10], 2: [10, 10], 3: [90, 90] })[id] ?? null };

test("in the exact placement each hypothesis has its own position, the most probable last", () => {
  const places = placesOf({ hypotheses: [hypothesis(1, 0.6), hypothesis(2, 0.3)] }, exact);
  assert.deepEqual(places.map(({ ranks, position }) => [ranks, position]), [[[2], [2, 2]], [[1], [1, 1]]]);
  assert.equal(places[0].radius, 5);
});

test("an area lights up as a whole: its radius is that of a place", () => {
  const area = hypothesis(1, 0.6, { kind: "area", radius_px: null });
  assert.equal(placesOf({ hypotheses: [area], place_radius_px: 120 }, exact)[0].radius, 120);
  assert.equal(placesOf({ hypotheses: [{ ...area, kind: "photo" }], place_radius_px: 120 }, exact)[0].radius, null);
});

test("in another placement, hypotheses of one position are one, and their probabilities add up", () => {
  const places = placesOf({ hypotheses: [hypothesis(1, 0.3), hypothesis(2, 0.25), hypothesis(3, 0.4)] }, rooms);
  assert.deepEqual(places.map(({ ranks }) => ranks), [[3], [1, 2]]);
  assert.ok(Math.abs(places[1].probability - 0.55) < 1e-12);
  assert.equal(places[1].radius, null);
});

test("hypotheses whose photos are in no position of the placement are left out", () => {
  assert.deepEqual(placesOf({ hypotheses: [hypothesis(7, 0.9)] }, rooms), []);
  assert.deepEqual(placesOf(null, exact), []);
});

test("the server's verdict says whether a photo is on the map", () => {
  const answer = (verdict) => ({ hypotheses: [hypothesis(1, 0.3)], off_map_probability: 0.5, verdict });
  assert.deepEqual(["off_map", "perhaps_off_map", "nothing_to_see"].filter((verdict) => !isOffMap(answer(verdict))), []);
  assert.deepEqual(["place", "perhaps_place"].filter((verdict) => isOffMap(answer(verdict))), []);
});

test("an answer that was kept without a verdict is uncertain; without a place it is not on this map", () => {
  assert.equal(verdictOf({ hypotheses: [hypothesis(1, 0.9)] }), "perhaps_place");
  assert.ok(isOffMap({ hypotheses: [] }));
});

test("a position that is given by hand comes before the hypothesis until another one is chosen", () => {
  const session = new QuerySession();
  session.setAnswer({ hypotheses: [hypothesis(1, 0.6), hypothesis(2, 0.3)], off_map_probability: 0 });
  assert.deepEqual(session.position, [1, 1]);
  session.setSpot([40, 50]);
  assert.deepEqual(session.position, [40, 50]);
  session.choose(2);
  assert.deepEqual(session.position, [2, 2]);
});

test("not on this map is listed by its probability, never above other places that are more probable", () => {
  const order = (probabilities, off, other) =>
    ranking({ hypotheses: probabilities.map((p, n) => hypothesis(n + 1, p)), off_map_probability: off, other_probability: other }).map(({ kind }) => kind).join(" ");
  assert.equal(order([0.2, 0.1], 0.3, 0.4), "place place other off");
  assert.equal(order([0.5, 0.1], 0.3, 0.1), "place off place other");
  assert.equal(order([0.2], 0.7, 0.1), "off place other");
  assert.equal(order([0.6, 0.3], 0.1, 0), "place place off");
  assert.equal(order([0.6], null, 0.4), "place other");
});

test("each verdict of the terminal has a sentence on the pages", () => {
  const verdicts = JSON.parse(readFileSync("tests/render/verdicts.json", "utf8")).map(({ verdict }) => verdict);
  const sentences = new Map([...verdicts, "nothing_to_see"].map((verdict) => [verdict, verdictText({ hypotheses: [], verdict })]));
  assert.deepEqual([sentences.size, new Set(sentences.values()).size], [5, 5]);
});

test("places are hollow where something else leads, or where they are improbable; shares of votes never are", () => {
  const answer = (first, off, other = 0) => ({ hypotheses: [hypothesis(1, first)], off_map_probability: off, other_probability: other });
  assert.equal(isFaint(answer(0.6, 0.1), 0.6), false);
  assert.equal(isFaint(answer(0.6, 0.1), 0.04), true);
  assert.equal(isFaint(answer(0.2, 0.4), 0.2), true);
  assert.equal(isFaint(answer(0.2, 0.1, 0.5), 0.2), true);
  assert.deepEqual([isFaint(answer(0.01, null, 0.9), 0.01), isMinor(answer(0.01, null), 0.01)], [false, false]);
});
