import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { MapStore, pendingKey } = await import("../../static/js/shared/map/map-store.js");

const photo = (id, fields = {}) => ({ id, name: `${id}.jpg`, revision: 1, taken_at: null, x_px: null, y_px: null, heading_deg: null, ...fields });
const make = (photos, placements = []) =>
  new MapStore({ slug: "park", name: "Park", can_edit: true, revision: 1, photos, placements, undo: null, redo: null, satellite: null });

test("photos are ordered by time, then by name with its numbers", () => {
  const store = make([photo(1, { name: "b10.jpg" }), photo(2, { name: "b9.jpg" }), photo(3, { name: "z.jpg", taken_at: "2026-01-01T10:00:00" })]);
  assert.deepEqual(store.order, [3, 2, 1]);
});

test("a preview lies over a pending edit, which lies over the server's state", () => {
  const store = make([photo(1, { x_px: 1, y_px: 1, heading_deg: 10 })]);
  store.setPending(new Map([[pendingKey(null, 1), { x_px: 2, y_px: 2 }]]));
  assert.deepEqual(store.position(1), [2, 2]);
  store.setPreview(new Map([[1, { x_px: 3, y_px: 3 }]]));
  assert.deepEqual(store.position(1), [3, 3]);
  assert.equal(store.heading(1), 10);
  store.setPreview(new Map());
  store.setPending(new Map());
  assert.deepEqual(store.position(1), [1, 1]);
});

test("positions belong to a placement, headings to the photo", () => {
  const store = make([photo(1, { x_px: 1, y_px: 1 })], [{ name: "rooms", positions: { 1: [50, 60] } }]);
  store.setPending(new Map([[pendingKey("rooms", 1), { x_px: 70, y_px: 80 }]]));
  assert.deepEqual(store.position(1), [1, 1]);
  store.showPlacement("rooms");
  assert.deepEqual(store.position(1), [70, 80]);
});

test("an older answer does not overwrite a newer one", () => {
  const store = make([photo(1, { revision: 5, x_px: 5, y_px: 5 })]);
  store.merge({ photos: [photo(1, { revision: 4, x_px: 4, y_px: 4 })] });
  assert.deepEqual(store.position(1), [5, 5]);
});

test("a photo that is removed is neither current nor selected any more", () => {
  const store = make([photo(1), photo(2)]);
  store.setCurrent(1);
  store.setSelection([1, 2]);
  store.merge({ photos: [{ id: 1, removed: true }] });
  assert.equal(store.currentId, null);
  assert.deepEqual([...store.selection], [2]);
});

test("a placement that was deleted is not shown any more", () => {
  const store = make([photo(1)], [{ name: "rooms", positions: {} }]);
  store.showPlacement("rooms");
  store.merge({ placements: [] });
  assert.equal(store.placement, null);
});
