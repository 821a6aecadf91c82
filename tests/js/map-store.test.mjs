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

test("a place that was suggested is not exact until the photo is moved", () => {
  const store = make([photo(1, { x_px: 1, y_px: 1, radius_px: 7 })], [{ name: "rooms", positions: { 1: [50, 60] } }]);
  assert.equal(store.radius(1), 7);
  store.setPending(new Map([[pendingKey(null, 1), { x_px: 2, y_px: 2 }]]));
  assert.equal(store.radius(1), null);
  store.setPending(new Map());
  store.showPlacement("rooms");
  assert.equal(store.radius(1), null);
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

const dotsOf = (ids) => ({ id: ids, x_px: ids.map((id) => id), y_px: ids.map(() => 2), heading_deg: ids.map(() => null), fov_deg: ids.map(() => 65), floor: ids.map(() => 0) });

test("photos of which the page has only the dots are there, after those that it knows", () => {
  const store = new MapStore({ photos: [photo(7)], dots: dotsOf([3, 5]), placements: [], satellite: null });
  assert.deepEqual(store.order, [7, 3, 5]);
  assert.deepEqual(store.position(5), [5, 2]);
  assert.deepEqual([7, 3].map((id) => store.isKnown(id)), [true, false]);
});

test("details come in order, never over what is newer, and never for what is gone", () => {
  const store = new MapStore({ photos: [], dots: dotsOf([1, 2, 3]), placements: [], satellite: null });
  store.merge({ photos: [photo(2, { revision: 9, x_px: 90, y_px: 0 }), { id: 3, removed: true, revision: 9 }] });
  store.addDetails([photo(1, { taken_at: "2026-01-02" }), photo(2, { revision: 4, x_px: 4, y_px: 0 }), photo(3)]);
  assert.deepEqual(store.order, [1, 2]);
  assert.deepEqual(store.position(2), [90, 0]);
  assert.equal(store.isKnown(1), true);
});

test("the tray follows edits on their way and what others do", () => {
  const store = make([photo(1), photo(2)]);
  assert.deepEqual(store.unplaced(), [1, 2]);
  store.setPending(new Map([[pendingKey(null, 1), { x_px: 2, y_px: 2 }]]));
  assert.deepEqual(store.unplaced(), [2]);
  store.setPending(new Map());
  store.merge({ photos: [photo(2, { revision: 2, x_px: 1, y_px: 1 })] });
  assert.deepEqual(store.unplaced(), [1]);
  store.setPreview(new Map([[1, { x_px: 3, y_px: 3 }]]));
  assert.deepEqual(store.unplaced(), []);
});
