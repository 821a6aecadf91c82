import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { partsOfMask } = await import("../../static/js/editor/photos/mask-boxes.js");

const box = (x, y, width, height) => ({ x, y, width, height });

test("boxes that lie edge to edge are one mask, those that were drawn are not", () => {
  const stairs = [box(0, 0.9, 1, 0.1), box(0.1, 0.85, 0.3, 0.05), box(0.6, 0.85, 0.33333, 0.05), box(0.93333, 0.85, 0.06667, 0.05)];
  const drawn = [box(0.15, 0.5, 0.2, 0.2), box(0.3, 0.6, 0.2, 0.2), box(0.2, 0.87, 0.1, 0.05)];
  assert.deepEqual(new Set(partsOfMask([...drawn, ...stairs])), new Set(stairs));
});

test("two boxes side by side, and boxes that touch at corners alone, are no mask", () => {
  assert.deepEqual(partsOfMask([box(0, 0, 0.5, 0.5), box(0.5, 0, 0.5, 0.5)]), []);
  assert.deepEqual(partsOfMask([box(0, 0, 0.2, 0.2), box(0.2, 0.2, 0.2, 0.2), box(0.4, 0.4, 0.2, 0.2)]), []);
});

test("a mask is found in whatever order its boxes come", () => {
  const parts = [box(0, 0, 0.2, 0.2), box(0.4, 0, 0.2, 0.2), box(0.2, 0, 0.2, 0.2)];
  assert.equal(partsOfMask(parts).length, 3);
});
