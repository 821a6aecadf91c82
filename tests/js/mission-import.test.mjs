import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { headingTo, laid, StartPose } = await import("../../static/js/missions/import/start-pose.js");
const { mappingText, rowsOf } = await import("../../static/js/missions/import/column-mapping.js");
const { StagedFile } = await import("../../static/js/missions/import/staged-file.js");

const PRAGUE = { lat: 50, lon: 14, heading_deg: 90 };
const near = (value, wanted, least = 1e-7) => assert.ok(Math.abs(value - wanted) < least, `${value} is not ${wanted}`);

test("a track in metres is laid where the robot started and looked", () => {
  const [from, ahead, left] = laid([[0, 0], [71.696, 0], [0, 111.229]], PRAGUE);
  assert.deepEqual(from, [50, 14]);
  near(ahead[0], 50);
  near(ahead[1], 14.001, 1e-6); // to the east, where the robot was facing
  near(left[0], 50.001, 1e-6);
  near(left[1], 14);
});

test("a second click gives the heading in which a track then goes", () => {
  for (const heading of [0, 12.3, 90, 180, 271.4, 359.9]) {
    const [, there] = laid([[0, 0], [40, 0]], { ...PRAGUE, heading_deg: heading });
    assert.equal(headingTo([50, 14], there), heading);
  }
});

test("half a start says what is missing, and is no start", () => {
  const start = new StartPose();
  assert.equal(start.problem, "");
  assert.equal(start.whole, null);
  start.moveTo([50, 14]);
  assert.match(start.problem, /needs a heading/);
  assert.equal(start.whole, null);
  start.turnTo(90);
  assert.equal(start.problem, "");
  assert.deepEqual(start.whole, PRAGUE);
  start.set([50, null, 90]);
  assert.match(start.problem, /latitude and a longitude/);
  start.set([95, 14, 90]);
  assert.match(start.problem, /not on the Earth/);
  assert.equal(start.whole, null);
});

test("a mapping begins with what the server has found, with fields that are not offered, and their units", () => {
  const rows = rowsOf({ columns: { lat: 1, lon: 2, qx: 4 }, units: { lat: "e7", lon: "e7", qx: "1" } });
  assert.equal(mappingText(rows), "lat=2:e7, lon=3:e7, qx=5:1");
  const time = rows.find(({ name }) => name === "time");
  assert.equal(time.column, "");
  time.column = "1";
  assert.equal(mappingText(rows), "time=1:s, lat=2:e7, lon=3:e7, qx=5:1");
});

/** A server that records its requests. */
class Server {
  constructor(answers) {
    this.answers = answers;
    this.asked = [];
    this.sent = 0;
    this.begin = async () => {
      this.sent += 1;
      return { id: `f${this.sent}`, offset: 0, chunk_bytes: 3 };
    };
    this.sendChunk = async (id, chunk, { headers }) => ({ offset: Number(headers["Upload-Offset"]) + chunk.size });
    this.contents = (id, reading) => {
      this.asked.push(reading.columns);
      return this.answers[reading.columns];
    };
    this.dropped = [];
    this.drop = async (id) => this.dropped.push(id);
  }
}

const contents = (...tracks) => ({ kind: "table", objects: 0, sources: tracks.map((track) => ({ source: "gps", track, frame: "earth" })) });

test("a file is sent in chunks, looked at, and dropped with the dialog", async () => {
  const server = new Server({ "": contents("a", "b") });
  const file = new StagedFile(new File(["1234567"], "log.csv"), server);
  await file.open();
  assert.equal(file.state, "ready");
  file.choose(file.contents.sources[0], false);
  assert.deepEqual(file.wanted.map(({ track }) => track), ["b"]);
  file.close();
  assert.deepEqual(server.dropped, ["f1"]);
});

test("a file that is refused is dropped at once, and says why", async () => {
  const server = new Server({ "": Promise.reject(new Error("no track")) });
  const file = new StagedFile(new File(["x"], "photo.jpg"), server);
  await file.open();
  assert.deepEqual([file.state, file.error.message, file.isUsable], ["refused", "no track", false]);
  assert.deepEqual(server.dropped, ["f1"]);
});

test("of two readings the later one counts, whichever answer comes last", async () => {
  let answerFirst = null;
  const server = new Server({ "": new Promise((resolve) => (answerFirst = resolve)), "lat=1": contents("late") });
  const file = new StagedFile(new File(["x"], "log.csv"), server);
  const opened = file.open();
  while (!server.asked.length) await new Promise(setImmediate);
  const ready = new Promise((resolve) => file.addEventListener("change", () => file.contents && resolve()));
  file.readAs({ columns: "lat=1" });
  await ready;
  answerFirst(contents("early"));
  await opened;
  assert.deepEqual(file.contents.sources.map(({ track }) => track), ["late"]);
});

test("a job that reads in an earlier way is cancelled before the next one begins", async () => {
  const server = new Server({ "": { job: 1 }, "lat=1": { job: 2 } });
  server.cancel = async (job) => server.asked.push(`cancel ${job}`);
  server.job = async (job) => (job === 2 ? { state: "done", result: contents("late") } : { state: "running" });
  const file = new StagedFile(new File(["x"], "log.csv"), server);
  const opened = file.open();
  while (file.job === null) await new Promise(setImmediate);
  file.readAs({ columns: "lat=1" });
  await opened;
  while (file.state !== "ready") await new Promise(setImmediate);
  assert.deepEqual(server.asked, ["", "cancel 1", "lat=1"]);
  assert.deepEqual(file.contents.sources.map(({ track }) => track), ["late"]);
});

test("a job that is queued for an earlier question is cancelled", async () => {
  let answerFirst = null;
  const server = new Server({ "": new Promise((resolve) => (answerFirst = resolve)), "lat=1": contents("late") });
  const cancelled = [];
  server.cancel = async (job) => cancelled.push(job);
  const file = new StagedFile(new File(["x"], "log.csv"), server);
  const opened = file.open();
  while (!server.asked.length) await new Promise(setImmediate);
  file.readAs({ columns: "lat=1" });
  while (file.state !== "ready") await new Promise(setImmediate);
  answerFirst({ job: 1 });
  await opened;
  assert.deepEqual(cancelled, [1]);
});

test("a file whose import failed is sent again for the next one", async () => {
  const server = new Server({ "": contents("a", "b") });
  const wishes = [];
  server.importFile = async (id, wish) => wishes.push([id, wish]) && { job: wishes.length };
  server.job = async (job) => (job === 1 ? { state: "failed", error: { message: "no", hint: null } } : { state: "done", result: { mission: 7 } });
  const file = new StagedFile(new File(["x"], "log.csv"), server);
  await file.open();
  file.choose(file.contents.sources[1], false);
  assert.equal(await file.bringIn({ mission: 7 }), null);
  assert.deepEqual([file.state, file.error.message], ["failed", "no"]);
  assert.equal(await file.bringIn({ mission: 7 }), 7);
  assert.equal(file.state, "done");
  assert.deepEqual(wishes.map(([id]) => id), ["f1", "f2"]);
  assert.deepEqual(wishes[1][1].tracks, [{ source: "gps", track: "a" }]);
});
