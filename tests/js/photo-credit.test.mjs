import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

const { mapCredit } = await import("../../static/js/shared/photo-credit.js");

test("a map names each service and licence once, and nobody where all photos are its own", () => {
  const street = { service: "Street", licence: "CC BY 4.0" };
  const photos = [{ source: street }, { source: null }, {}, { source: { ...street, id: "2" } }, { source: { service: "Alley", licence: "CC0" } }];
  assert.equal(mapCredit(photos), "Photos: Alley (CC0), Street (CC BY 4.0)");
  assert.equal(mapCredit([{ source: null }, {}]), "");
});
