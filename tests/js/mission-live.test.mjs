import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { MissionStore } = await import("../../static/js/missions/mission-store.js");
const { liveBadge } = await import("../../static/js/missions/live-badge.js");

globalThis.HTMLElement = /** @type {*} */ (class {});
const badge = Object.assign(/** @type {*} */ (new globalThis.HTMLElement()), { className: "", textContent: "" });
globalThis.document.getElementById = () => badge;

const OLD_S = 1_000_000;
const track = (id, source, poses) => ({ id, source, poses, timed: true, first_time_s: OLD_S, last_time_s: OLD_S + 60 });
const point = [0, OLD_S, 50, 14, null];

/** A mission that was recorded long ago, with its badge. */
function recorded(t) {
  t.mock.method(globalThis, "setInterval", () => 0);
  const store = new MissionStore(1, []);
  store.setMission({ id: 1, ended_at: null, tracks: [track(7, "gps", 20)] });
  liveBadge(store, () => true);
  const take = (...tracks) => store.merge(1, { tracks, track_ids: [...new Set([7, ...tracks.map(({ id }) => id)])], objects: [] });
  return { store, take };
}

test("a correction of an old recording does not make it live", (t) => {
  const { take } = recorded(t);
  assert.equal(badge.textContent, "Recorded");
  take({ ...track(8, "fused", 20), new: [point] });
  assert.equal(badge.textContent, "Recorded");
  take({ ...track(8, "fused", 30), new: [point] });
  assert.equal(badge.textContent, "Recorded");
});

test("a track that is imported does not make a mission live, a recording that is replayed does", (t) => {
  const { take } = recorded(t);
  take({ ...track(9, "gps", 20), new: [point] });
  assert.equal(badge.textContent, "Recorded");
  take({ ...track(9, "gps", 21), new: [point] });
  assert.equal(badge.textContent, "Live");
});

test("a track that was removed elsewhere disappears", (t) => {
  const { store, take } = recorded(t);
  take({ ...track(8, "fused", 20), new: [point] });
  let shown = 0;
  store.on("missions", () => (shown += 1));
  take();
  assert.deepEqual(store.tracks.map(({ key }) => key), ["1/7"]);
  assert.equal(shown, 1);
});
