import assert from "node:assert/strict";
import { test } from "node:test";

import "./page.mjs";

/** A stand-in for an element, as far as the card needs it. */
class Element extends EventTarget {
  constructor(tag) {
    super();
    Object.assign(this, { tag, dataset: {}, attributes: {}, children: [], value: "", textContent: "" });
  }

  setAttribute(name, value) {
    this.attributes[name] = value;
  }

  append(...children) {
    this.children.push(...children);
  }

  replaceChildren(...children) {
    this.children = children;
    globalThis.document.activeElement = null;
  }

  focus() {
    globalThis.document.activeElement = this;
  }

  find(fits) {
    return fits(this) ? this : this.children.reduce((found, child) => found || child.find?.(fits), null);
  }
}

const card = new Element("section");
globalThis.Node = globalThis.HTMLElement = Element;
Object.assign(globalThis.document, {
  createElement: (tag) => new Element(tag),
  createElementNS: (_, tag) => new Element(tag),
  getElementById: ((before) => (id) => (id === "object" ? card : before(id)))(globalThis.document.getElementById),
  querySelector: () => ({ content: "icons.svg" }),
});

const { showObject } = await import("../../static/js/missions/object-card.js");

const CAR = { id: "car", key: "1/car", mission: 1, kind: "car", lat: 50, lon: 14, state: "found", state_time_s: null, first_time_s: 0, last_time_s: 0, count: 1 };

class Store extends EventTarget {
  objects = new Map([CAR, { ...CAR, id: "bus", key: "1/bus" }].map((one) => [one.key, one]));
  missions = new Map([[1, { can_edit: true }]]);
  symbols = { element: () => new Element("svg") };
  chosen = null;
  sent = [];
  setTrail() {}

  server() {
    return {
      object: (id) => new Promise((resolve) => (this.answer = () => resolve({ ...this.objects.get(`1/${id}`), sightings: [] }))),
      setState: async (id, change) => (this.sent.push(change), { ...this.objects.get(`1/${id}`), state: change.state, state_time_s: 9 }),
    };
  }

  on(name, run) {
    this.addEventListener(name, (event) => (this.shown = run(event)));
  }

  emit(name) {
    this.dispatchEvent(new Event(name));
  }

  setObjects(_, [object]) {
    this.objects.set(object.key, object);
    this.emit("objects");
  }

  choose(key) {
    this.chosen = key;
    this.emit("chosen");
  }
}

const note = () => card.find(({ tag }) => tag === "input");
const ticks = () => new Promise((resolve) => setImmediate(resolve));

test("a note outlives details that arrive and what others set, and is empty once it is sent", async () => {
  const store = new Store();
  showObject(store);
  store.choose(CAR.key);
  note().value = "second floor";
  note().focus();
  store.answer();
  await ticks();
  assert.equal(note().value, "second floor");
  assert.equal(globalThis.document.activeElement, note());

  store.setObjects(1, [{ ...CAR, state: "confirmed", state_time_s: 5 }]);
  assert.equal(note().value, "second floor");

  card.find(({ dataset }) => dataset.state === "cleared").dispatchEvent(new Event("click"));
  await ticks();
  assert.deepEqual(store.sent, [{ state: "cleared", was: "confirmed", note: "second floor" }]);
  assert.equal(note().value, "");

  note().value = "of the car";
  store.choose("1/bus");
  assert.equal(note().value, "");
});
