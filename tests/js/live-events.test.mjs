import assert from "node:assert/strict";
import { setImmediate as settled } from "node:timers/promises";
import { test } from "node:test";

import "./page.mjs";

const heard = { document: {}, window: {} };
globalThis.document.addEventListener = (name, run) => (heard.document[name] = run);
globalThis.addEventListener = (name, run) => (heard.window[name] = run);
const { Live } = await import("../../static/js/missions/live-events.js");

const gone = Object.assign(new Error("gone"), { status: 404 });

/** An ended mission, which the page polls from time to time, or a live one; `answer` completes the request. */
function follow(t, { ended }) {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const seen = { opened: 0, open: 0, asked: 0, gone: 0, answer: null };
  const store = {
    missions: new Map([[1, { cursor: "", objects: 0, ended_at: ended ? "2026-01-01" : null }]]),
    refresh: () => {},
    server: () => ({
      state: () => new Promise((resolve, reject) => {
        seen.asked += 1;
        seen.answer = (error) => (error ? reject(error) : resolve({}));
      }),
      events: () => {
        seen.opened += 1;
        seen.open += 1;
        return { close: () => (seen.open -= 1) };
      },
    }),
  };
  const live = new Live(/** @type {*} */ (store), 1);
  live.addEventListener("gone", () => (seen.gone += 1));
  live.start();
  return { live, seen, mission: store.missions.get(1) };
}

test("a mission that has ended is asked for again and again", async (t) => {
  const { seen } = follow(t, { ended: true });
  for (const times of [1, 2]) {
    t.mock.timers.tick(15_000);
    assert.equal(seen.asked, times);
    seen.answer();
    await settled();
  }
  assert.equal(seen.opened, 0);
});

test("what is paused is asked for no more, though an answer was on its way", async (t) => {
  const { live, seen, mission } = follow(t, { ended: true });
  t.mock.timers.tick(15_000);
  mission.ended_at = null; // live: a stream would be opened
  live.pause();
  seen.answer();
  await settled();
  assert.equal(seen.opened, 0);
});

test("what is paused does not count as gone, and a look at the page does not open it", async (t) => {
  const { live, seen } = follow(t, { ended: false });
  assert.equal(seen.open, 1);
  const asked = live.refresh();
  live.pause();
  seen.answer(gone);
  await asked;
  heard.document.visibilitychange();
  heard.window.online();
  assert.deepEqual([seen.open, seen.opened, seen.gone], [0, 1, 0]);
  live.start();
  assert.equal(seen.open, 1);
});

test("a mission that is no longer there is reported, and asked for no more", async (t) => {
  const { live, seen } = follow(t, { ended: false });
  const asked = live.refresh();
  seen.answer(gone);
  await asked;
  heard.window.online();
  assert.deepEqual([seen.open, seen.gone], [0, 1]);
});
