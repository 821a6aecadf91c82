import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

globalThis.ResizeObserver = class {};
const { gridLayout, inSight } = await import("../../static/js/shared/virtual-grid.js");
const { PhotoOrder } = await import("../../static/js/editor/photos/photo-order.js");
const { headingsAlong } = await import("../../static/js/editor/photos/heading-dialog.js");
const { MapStore } = await import("../../static/js/shared/map/map-store.js");

const LOOK = { least: 84, label: 20, strip: false };

test("columns fill the width, and the rows hold all photos", () => {
  const { columns, tile, step, size } = gridLayout({ width: 320, height: 450 }, { ...LOOK, count: 20_000 });
  assert.equal(columns, 3);
  assert.ok(tile[0] >= 84 && 8 + 3 * step[0] <= 320 + step[0] - tile[0]);
  assert.equal(size[1], 16 + Math.ceil(20_000 / 3) * step[1]);
});

test("a grid too narrow for one photo has one column", () => {
  assert.equal(gridLayout({ width: 60, height: 100 }, { ...LOOK, count: 5 }).columns, 1);
});

test("a strip is one row as high as its box", () => {
  const { columns, tile, size } = gridLayout({ width: 900, height: 120 }, { ...LOOK, count: 50, strip: true });
  assert.deepEqual([columns, tile[1], size[1]], [50, 104, 120]);
});

test("only the photos in and near sight are made, at the start, in the middle and at the end", () => {
  const tiles = { count: 20_000, strip: false };
  const layout = gridLayout({ width: 320, height: 450 }, { ...LOOK, count: 20_000 });
  const sight = (top) => inSight(layout, { left: 0, top, width: 320, height: 450 }, tiles);
  assert.equal(sight(0)[0], 0);
  const [first, last] = sight(10_000 * layout.step[1] / 3);
  assert.ok(first <= 10_000 && first > 9_980 && last - first < 40);
  assert.equal(sight(layout.size[1])[1], 20_000);
});

const photo = (id, fields) => ({ id, name: `${id}.jpg`, revision: 1, taken_at: `2026-05-0${id}T10:00:00`, x_px: null, y_px: null, heading_deg: null, gps: null, ...fields });
const make = (photos) =>
  new MapStore({ slug: "park", name: "Park", can_edit: true, revision: 1, photos, placements: [], undo: null, redo: null, satellite: null });
const park = () => make([
  photo(1, { name: "b2.jpg", x_px: 100, y_px: 0 }),
  photo(2, { name: "b10.jpg", gps: { x_px: 12, y_px: 0 } }),
  photo(3, { name: "a.jpg", x_px: 10, y_px: 0, heading_deg: 90 }),
  photo(4, { name: "c.jpg" }),
]);

test("photos are sorted by time, name, place, and distance from one of them", () => {
  const order = new PhotoOrder(park());
  assert.deepEqual(order.sorted(), [1, 2, 3, 4]);
  order.sortBy("name");
  assert.deepEqual(order.sorted(), [3, 1, 2, 4]);
  order.sortBy("placed");
  assert.deepEqual(order.sorted(), [1, 3, 2, 4]);
  order.sortBy("distance", 3);
  assert.deepEqual(order.sorted(), [3, 2, 1, 4]);
});

test("filters leave out photos, together; clearing keeps the search", () => {
  const order = new PhotoOrder(park());
  assert.deepEqual(order.shown(), [2, 4]); // initially those in the tray
  order.show("all");
  order.filter({ gps: "yes" });
  assert.deepEqual(order.shown(), [2]);
  order.filter({ gps: "no", heading: "no" });
  assert.deepEqual(order.shown(), [1, 4]);
  order.filter({ from: "2026-05-02", to: "2026-05-04", text: "C" });
  assert.deepEqual([order.shown(), order.active], [[4], 3]);
  order.clear();
  assert.deepEqual([order.shown(), order.active], [[4], 0]);
});

test("a map whose photos are all placed begins with all of them", () => {
  assert.deepEqual(new PhotoOrder(make([photo(1, { x_px: 1, y_px: 1 })])).shown(), [1]);
});

test("along the way each photo looks to the next, the last one on, and those of one spot alike", () => {
  const store = make([
    photo(1, { x_px: 0, y_px: 0 }), photo(2, { x_px: 0, y_px: 0 }), photo(3, { x_px: 10, y_px: 0 }), photo(4), photo(5, { x_px: 10, y_px: 10 }),
  ]);
  assert.deepEqual([...headingsAlong([1, 2, 3, 4, 5], store)], [[1, 90], [2, 90], [3, 180], [5, 180]]);
  assert.equal(headingsAlong([1, 2], store).size, 0);
});

test("filters keep photos by their notes, their tags and how their positions are known", () => {
  const photos = [
    photo(1, { camera: "Canon EOS 5D", note: "by the #Gate", x_px: 5, y_px: 5, radius_px: 3 }),
    photo(2, { note: "oak", sky: "clear", x_px: 5, y_px: 5, radius_px: null }),
    photo(3, { note: null }),
  ];
  const order = new PhotoOrder(new MapStore({ photos, placements: [], satellite: null }));
  order.show("all");
  const shown = (filters) => {
    order.clear();
    order.filter(filters);
    return order.shown();
  };
  assert.deepEqual(shown({ note: "yes" }), [1, 2]);
  assert.deepEqual(shown({ note: "no" }), [3]);
  assert.deepEqual(shown({ note: "#gate" }), [1]);
  assert.deepEqual([shown({ sky: "=clear" }), shown({ sky: "=grey" }), shown({ text: "clear" }), shown({ text: "" })], [[2], [], [2], [1, 2, 3]]);
  assert.deepEqual(shown({ accuracy: "suggested" }), [1]);
  assert.deepEqual(shown({ accuracy: "exact" }), [2]);
  assert.deepEqual(shown({ camera: "Canon EOS 5D" }), [1]);
  assert.equal(order.active, 1);
});
