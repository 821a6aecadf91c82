import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { countTags, retagged, tagsOf } = await import("../../static/js/editor/photos/tags.js");

test("tags are the words of a note that begin with #", () => {
  assert.deepEqual(tagsOf("By the #Gate, #north-west and #GATE; step #2, a#b, https://a.org/#c, #žluť."), ["gate", "north-west", "žluť"]);
  assert.deepEqual(tagsOf(null), []);
  assert.deepEqual([...countTags([{ note: "#b #a" }, { note: "#a" }, {}])], [["a", 2], ["b", 1]]);
});

test("tags come to a note and go, and its other words stay", () => {
  assert.equal(retagged("Old oak", { add: ["tree", "Tree", "north"] }), "Old oak #tree #north");
  assert.equal(retagged("Old oak #tree", { add: ["tree"] }), "Old oak #tree");
  assert.equal(retagged("By the #gate of  the park\n#north #gate", { remove: ["gate"] }), "By the of the park\n#north");
  assert.equal(retagged("#gates and #gate", { remove: ["gate"] }), "#gates and");
  assert.equal(retagged("north   door\n  - one", { remove: ["gate"] }), "north   door\n  - one");
  assert.equal(retagged(null, {}), "");
  assert.equal(retagged("two  spaces", {}), "two  spaces");
});
