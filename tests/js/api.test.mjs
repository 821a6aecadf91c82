import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { file, get, post } = await import("../../static/js/shared/api.js");

/** Respond to requests in order with these responses; returns the requested addresses. */
function serve(...answers) {
  const asked = [];
  globalThis.window = { dispatchEvent: () => {} };
  globalThis.fetch = async (path) => {
    asked.push(path);
    return answers.shift();
  };
  return asked;
}

const json = (status, content, headers = {}) =>
  new Response(JSON.stringify(content), { status, headers: { "Content-Type": "application/json", ...headers } });
const busy = (seconds) => json(503, { error: { code: "busy", message: "the server is busy" } }, { "Retry-After": seconds });

test("what a busy server asks to wait for is waited for", async () => {
  const asked = serve(busy("0"), busy("0"), new Response("points"));
  assert.equal(await (await file("/shared/x/landmarks/points/k/0")).text(), "points");
  assert.equal(asked.length, 3);
});

test("a server that is gone for long is not waited for", async () => {
  const asked = serve(busy("60"));
  await assert.rejects(get("/maps"), { status: 503, code: "busy" });
  assert.equal(asked.length, 1);
});

test("what changes something is sent once", async () => {
  const asked = serve(busy("0"));
  await assert.rejects(post("/maps", { name: "Park" }), { status: 503 });
  assert.equal(asked.length, 1);
});
