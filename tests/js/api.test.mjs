import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { file, get, post, upload } = await import("../../static/js/shared/api.js");

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

/** A request whose response the test sends in parts. */
class Sent {
  upload = {};
  status = 200;
  responseText = "";
  headers = {};

  open() {}

  setRequestHeader(name, value) {
    this.headers[name] = value;
  }

  getResponseHeader() {
    return this.type;
  }

  send() {
    Sent.last = this;
  }

  arrive(text, type = "text/event-stream; charset=utf-8") {
    this.type = type;
    this.responseText += text;
    this.onprogress?.();
  }

  end() {
    this.response = this.responseText;
    this.onload();
  }
}

const event = (kind, data) => `event: ${kind}\ndata: ${JSON.stringify(data)}\n\n`;

/** Begin an upload; `request`, its `events` so far, and the `answer`. */
function askForEvents() {
  globalThis.XMLHttpRequest = Sent;
  const events = [];
  const answer = upload("/maps/park/localize", { body: new Blob(), onEvent: (kind, data) => events.push([kind, data]) });
  return { request: Sent.last, events, answer };
}

test("events before the answer are read as they arrive, also in pieces", async () => {
  const { request, events, answer } = askForEvents();
  assert.match(request.headers.Accept, /^text\/event-stream, application\/json/);
  const first = event("first", { sentence: "At the pond: perhaps" });
  request.arrive(event("progress", { photos: 29 }) + first.slice(0, 20));
  assert.deepEqual(events, [["progress", { photos: 29 }]]);
  request.arrive(first.slice(20));
  assert.deepEqual(events[1], ["first", { sentence: "At the pond: perhaps" }]);
  request.arrive(event("answer", { id: 7 }));
  request.end();
  assert.deepEqual(await answer, { id: 7 });
  assert.equal(events.length, 2);
});

test("an error among the events is thrown, and so is a stream that is cut off", async () => {
  const refused = askForEvents();
  refused.request.arrive(event("first", {}) + event("error", { status: 507, error: { code: "disk_full", message: "full" } }));
  refused.request.end();
  await assert.rejects(refused.answer, { status: 507, code: "disk_full", message: "full" });
  const cut = askForEvents();
  cut.request.arrive(event("first", {}));
  cut.request.end();
  await assert.rejects(cut.answer, { code: "offline" });
});

test("a server that sends no events is answered in JSON", async () => {
  const { request, events, answer } = askForEvents();
  request.arrive('{"id": 3}', "application/json");
  request.end();
  assert.deepEqual([await answer, events], [{ id: 3 }, []]);
});
