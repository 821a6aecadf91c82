import assert from "node:assert/strict";
import { test } from "node:test";
import { setTimeout as pause } from "node:timers/promises";

import "./page.mjs";

const { EditQueue } = await import("../../static/js/editor/edit-queue.js");
const { MapStore } = await import("../../static/js/shared/map/map-store.js");

const photo = (id, fields = {}) => ({ id, name: `${id}.jpg`, revision: 1, x_px: null, y_px: null, heading_deg: null, ...fields });
const state = (photos) => ({
  slug: "park", name: "Park", can_edit: true, revision: 1, photos, placements: [], undo: null, redo: null, satellite: null, georeference: null,
});
const failure = (status, message = "no") => Object.assign(new Error(message), { status, hint: null });

/** A server of one map that applies edits, or throws the next error of `answers`. */
function begin(photos = [photo(1), photo(2)], answers = []) {
  const store = new MapStore(state(photos));
  const server = { revision: 1, photos: new Map(photos.map((one) => [one.id, one])), requests: [] };
  const change = (request, applied) => {
    server.requests.push(request);
    const answer = answers.shift();
    if (answer?.before) throw answer.before;
    server.revision += 1;
    const changed = applied.map((fields) => ({ ...server.photos.get(fields.id), ...fields, revision: server.revision }));
    for (const one of changed) server.photos.set(one.id, one);
    if (answer?.after) throw answer.after; // it was applied, but the response is lost
    return { revision: server.revision, photos: changed, undo: null, redo: null };
  };
  server.edit = async (request) => change(request, request.changes);
  server.remove = async (request) => change(request, request.ids.map((id) => ({ id, removed: true })));
  server.undo = async () => change({ undo: true }, []);
  const refresh = async () => {
    store.merge({ photos: [...server.photos.values()] });
    store.revision = server.revision;
  };
  const queue = new EditQueue(store, server, refresh);
  const refused = [];
  queue.addEventListener("refused", ({ detail }) => refused.push(detail.message));
  return { store, server, queue, refused };
}

async function saved(queue) {
  for (let n = 0; n < 400 && queue.waiting; n += 1) await pause(10);
  assert.equal(queue.waiting, 0, "not saved in time");
  await pause(0);
}

test("an edit is shown at once and saved once", async () => {
  const { store, server, queue } = begin();
  queue.edit("place", [{ id: 1, x_px: 10, y_px: 20 }]);
  assert.deepEqual(store.position(1), [10, 20]);
  assert.equal(queue.waiting, 1);
  await saved(queue);
  assert.deepEqual(store.position(1), [10, 20]);
  assert.equal(server.requests.length, 1);
  assert.equal(store.revision, 2);
});

test("edits are sent one after another, in their order", async () => {
  const { server, queue } = begin();
  for (const x of [1, 2, 3]) queue.edit("move", [{ id: 1, x_px: x, y_px: 0 }]);
  await saved(queue);
  assert.deepEqual(server.requests.map(({ changes }) => changes[0].x_px), [1, 2, 3]);
  assert.deepEqual(server.requests.map(({ seen }) => seen), [1, 2, 3], "own edits are no conflict");
});

test("small turns of one photo are collected into one edit", async () => {
  const { server, queue } = begin();
  for (const degrees of [5, 10, 15]) queue.edit("turn", [{ id: 1, heading_deg: degrees }]);
  assert.equal(queue.waiting, 1);
  await saved(queue);
  assert.deepEqual(server.requests.map(({ changes }) => changes[0].heading_deg), [15]);
});

test("a refused edit is taken back and reported", async () => {
  const { store, queue, refused } = begin([photo(1, { x_px: 5, y_px: 5 })], [{ before: failure(422, "off the image") }]);
  queue.edit("move", [{ id: 1, x_px: 900, y_px: 5 }]);
  await saved(queue);
  assert.deepEqual(store.position(1), [5, 5]);
  assert.deepEqual(refused, ["off the image"]);
});

test("a conflict gives up the edit and those after it of the same photo, and no others", async () => {
  const { store, server, queue, refused } = begin(undefined, [{ before: failure(412, "changed by others") }]);
  queue.edit("place", [{ id: 1, x_px: 1, y_px: 1 }]);
  queue.edit("move", [{ id: 1, x_px: 2, y_px: 2 }]);
  queue.edit("place", [{ id: 2, x_px: 3, y_px: 3 }]);
  await saved(queue);
  assert.equal(store.position(1), null);
  assert.deepEqual(store.position(2), [3, 3]);
  assert.deepEqual(refused, ["changed by others"]);
  assert.equal(server.requests.length, 2);
});

test("an edit that never arrived is sent again", async () => {
  const { store, server, queue, refused } = begin(undefined, [{ before: failure(0) }]);
  queue.edit("place", [{ id: 1, x_px: 7, y_px: 8 }]);
  await saved(queue);
  assert.deepEqual(store.position(1), [7, 8]);
  assert.equal(server.requests.length, 2);
  assert.deepEqual(refused, []);
});

test("an edit whose answer was lost is not applied twice", async () => {
  const { store, server, queue } = begin(undefined, [{ after: failure(0) }]);
  queue.edit("place", [{ id: 1, x_px: 7, y_px: 8 }]);
  await saved(queue);
  assert.deepEqual(store.position(1), [7, 8]);
  assert.equal(server.requests.length, 1);
});

test("an edit of a photo that somebody else changed meanwhile is sent with what its author had seen", async () => {
  const { store, server, queue } = begin();
  store.merge({ photos: [photo(1, { revision: 9, x_px: 1, y_px: 1 })] });
  queue.edit("move", [{ id: 1, x_px: 2, y_px: 2 }]);
  store.revision = 9;
  await saved(queue);
  assert.equal(server.requests[0].seen, 1);
});

test("removed photos leave the list at once, and come back when that is refused", async () => {
  const { store, queue } = begin(undefined, [{ before: failure(422) }]);
  queue.remove([1]);
  assert.deepEqual(store.order, [2]);
  await saved(queue);
  assert.deepEqual(store.order, [1, 2]);
});
