import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";
import { isAmong } from "../../static/js/shared/accepted.js";
import { besidePhoto, isSidecar } from "../../static/js/shared/sidecars.js";

const file = (name, folder = "") => ({ name, size: 10, webkitRelativePath: folder && `${folder}/${name}` });
const names = (photo, others) => besidePhoto(file(photo), others.map((name) => file(name))).map(({ name }) => name);

test("files beside photos are known by their suffix", () => {
  assert.deepEqual(["a.xmp", "a.JPG.JSON", "a.jpg", "a.gpx"].map((name) => isSidecar({ name })), [true, true, false, false]);
});

test("files are known by the suffixes that a field accepts, not by media types", () => {
  assert.deepEqual(["A.CFG", "a.gpx", "a.plain", "cfg"].map((name) => isAmong({ name }, "positions")), [true, true, false, false]);
});

test("those that may belong to a photo are sent with it", () => {
  assert.deepEqual(names("a.jpg", ["b.xmp", "a.xmp", "ab.jpg.json", "a.jpg.json"]), ["a.xmp", "a.jpg.json"]);
  assert.deepEqual(names("a(1).jpg", ["a.jpg(1).json"]), ["a.jpg(1).json"]);
  assert.deepEqual(names("a-edited.jpg", ["a.jpg.json"]), ["a.jpg.json"]);
  assert.deepEqual(names(`${"x".repeat(47)}.jpg`, [`${"x".repeat(46)}.json`]), [`${"x".repeat(46)}.json`]);
});

test("only from the same folder, and only small ones", () => {
  const beside = besidePhoto(file("a.jpg", "in"), [file("a.xmp", "out"), file("a.xmp", "in"), { ...file("a.jpg.xmp", "in"), size: 300000 }]);
  assert.deepEqual(beside.map(({ webkitRelativePath: path }) => path), ["in/a.xmp"]);
});
