import assert from "node:assert/strict";
import { test } from "node:test";

import { ProgressiveImage } from "../../static/js/shared/progressive-image.js";

const PHOTO = { name: "a.jpg", thumb: "/thumb", preview: "/preview" };

/** What a picture of a browser does: `width` once it has loaded, and whether it is decoded ahead. */
function picture({ width = 0, decodes = true } = {}) {
  return {
    naturalWidth: width,
    addEventListener() {},
    removeAttribute() {},
    decode: () => (decodes ? Promise.resolve() : Promise.reject(new Error("EncodingError"))),
  };
}

async function shown(large) {
  globalThis.Image = function () {
    return large;
  };
  const classes = new Set();
  const frame = { classList: { add: (name) => classes.add(name), remove: (name) => classes.delete(name), toggle: (name, on) => (on ? classes.add(name) : classes.delete(name)) } };
  const image = picture();
  new ProgressiveImage(frame, image).show(PHOTO);
  await new Promise(setImmediate);
  return { src: image.src, broken: classes.has("is-broken") };
}

test("the large picture replaces the thumbnail", async () => {
  assert.deepEqual(await shown(picture({ width: 800 })), { src: "/preview", broken: false });
});

test("a large picture that has loaded is shown although the browser does not decode it ahead", async () => {
  assert.deepEqual(await shown(picture({ width: 800, decodes: false })), { src: "/preview", broken: false });
});

test("without any picture the frame is broken", async () => {
  assert.deepEqual(await shown(picture({ decodes: false })), { src: "/thumb", broken: true });
});
