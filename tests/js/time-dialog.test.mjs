import assert from "node:assert/strict";
import test from "node:test";

import "./page.mjs";

const { shiftedTimes } = await import("../../static/js/editor/photos/time-dialog.js");

test("times are shifted by as much as the first one, and keep their UTC offsets", () => {
  const photos = [
    { id: 1, taken_at: "2026-05-31T23:30:00+02:00" },
    { id: 2, taken_at: null },
    { id: 3, taken_at: "2026-05-31T12:00:00" },
    { id: 4, taken_at: "2026-05-31T12:00:00Z" },
  ];
  const shifted = shiftedTimes(photos, "2026-06-01T00:30:00");
  assert.deepEqual([...shifted], [
    [1, "2026-06-01T00:30:00+02:00"],
    [3, "2026-05-31T13:00:00"],
    [4, "2026-05-31T13:00:00Z"],
  ]);
});
