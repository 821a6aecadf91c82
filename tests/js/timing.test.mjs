import assert from "node:assert/strict";
import { mock, test } from "node:test";

import { debounce, rafThrottle } from "../../static/js/shared/timing.js";

test("a debounced function runs once after the last call, with its arguments", () => {
  mock.timers.enable({ apis: ["setTimeout"] });
  try {
    const seen = [];
    const later = debounce((...values) => seen.push(values), 100);
    later(1);
    mock.timers.tick(99);
    later(2, 3);
    mock.timers.tick(99);
    assert.deepEqual(seen, []);
    mock.timers.tick(1);
    assert.deepEqual(seen, [[2, 3]]);
    mock.timers.tick(1000);
    assert.equal(seen.length, 1);
  } finally {
    mock.timers.reset();
  }
});

test("a throttled function runs once a frame, and again when it is asked for in the next", () => {
  const frames = [];
  globalThis.requestAnimationFrame = (run) => frames.push(run);
  let runs = 0;
  const draw = rafThrottle(() => (runs += 1));
  draw();
  draw();
  assert.equal(frames.length, 1);
  frames.shift()();
  assert.equal(runs, 1);
  draw();
  frames.shift()();
  assert.equal(runs, 2);
});

test("what is asked for while a frame is drawn is drawn in the next one", () => {
  const frames = [];
  globalThis.requestAnimationFrame = (run) => frames.push(run);
  let runs = 0;
  const draw = rafThrottle(() => {
    runs += 1;
    if (runs === 1) draw();
  });
  draw();
  frames.shift()();
  frames.shift()();
  assert.equal(runs, 2);
});
