/** The dialog to draw boxes over faces and number plates, or have them suggested, for blurring in every picture. */

import { errorLine, openDialog } from "../shared/dialogs.js";
import { h, icon, preventTextDrag } from "../shared/dom.js";
import { percentText } from "../shared/format.js";
import { t, tn } from "../shared/i18n.js";

const LEAST = 0.008;
const NEW = { x: 0.4, y: 0.4, width: 0.2, height: 0.2 };
const STEP = 0.01;
/** A suggestion, which has a margin, is a duplicate if another box covers this fraction of it. */
const COVERED = 0.4;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** A box of the server; `kind`, and the network's confidence `score`, only for suggestions. @typedef {Api["BoxOut"] & Partial<Api["SuggestedBoxOut"]>} Box */

/**
 * Open the dialog for one photo, or for several, one after the other.
 * @param {Object[]} photos
 * @param {Object} server
 * @param {function(Object): Box[]} server.blurredNow boxes of a photo, as last known
 * @param {function(Object): Promise<{boxes: Box[], left?: number, missing: string[]}>} server.suggest finds faces and number plates in a photo
 * @param {function(Object, Box[], Box[]): Promise<void>} server.save saves boxes of a photo, unless it has others than the third argument
 * @param {?function(): Promise<void>} [server.searchAll] starts a job that searches all photos of the map
 * @returns {HTMLDialogElement}
 */
export function blurDialog(photos, { blurredNow, suggest, save, searchAll = null }) {
  const image = h("img", { draggable: "false" });
  const frame = h("div", { class: "blur-frame" }, image);
  const boxes = new Boxes(frame, []);
  const suggested = new Suggestions(boxes);
  const place = h("span", { class: "soft small", role: "status" });
  const error = errorLine();
  const none = h("span", { class: "small", role: "status" });
  const button = (words, attributes, ...inner) => h("button", { class: "button", type: "button", ...attributes }, ...inner, words);
  const add = button(t("Add a box"), { onclick: () => boxes.add({ ...NEW }) }, icon("plus"));
  const find = button(t("Suggest faces and plates"), { "data-testid": "blur-suggest" }, icon("person"));
  const skip = button(t("Next photo"), { "data-testid": "blur-skip" });
  const rest = button(t("Accept all"), { "data-testid": "blur-rest" });
  const send = button(t("Save"), { class: "button button--primary" });
  const all = button(t("Search all photos"), { class: "button button--quiet", "data-testid": "blur-all" });
  const text = t("Draw a box over each face and number plate. They are blurred in every picture that is shown; the original file is not changed.");
  const several = photos.length > 1;
  const tools = h("div", { class: "row" }, add, find, boxes.count, none, place, searchAll && !several && all);
  const body = [h("p", { class: "soft small" }, text), frame, suggested.list, tools, error];
  const dialog = openDialog(t("Blur faces and plates"), body, { actions: several ? [skip, rest, send] : [send] });
  dialog.classList.add("dialog--wide");
  let at = 0;
  let had = []; // boxes when the photo was shown
  let sought = false; // whether suggestions for the photo are shown
  const show = () => {
    const photo = photos[at];
    sought = false;
    Object.assign(image, { src: photo.preview, alt: photo.name });
    had = blurredNow(photo);
    boxes.replace(had.map((box) => ({ ...box })));
    suggested.show([]);
    none.textContent = "";
    place.textContent = several ? t("{n} of {all}", { n: at + 1, all: photos.length }) : "";
  };
  const seek = async () => {
    const found = await suggest(photos[at]);
    sought = true;
    const there = boxes.all;
    const more = found.boxes.filter((box) => !there.some((other) => covered(box, other) > COVERED));
    boxes.replace([...there, ...more]);
    suggested.show([...suggested.all.filter((box) => there.includes(box)), ...more]);
    const words = [found.boxes.length ? "" : t("Nothing was found."), found.left ? notAll(found.left) : "", ...found.missing.map(notSearched)];
    none.textContent = words.filter(Boolean).join(" ");
  };
  const next = async () => {
    at += 1;
    if (at === photos.length) return dialog.close();
    show();
    return several && seek();
  };
  const buttons = [find, skip, rest, send, all];
  /** One action at a time, so that boxes of one photo do not get into the next. */
  const run = async (does, pressed = null) => {
    for (const one of buttons) one.disabled = true;
    try {
      error.show(null);
      await does();
    } catch (problem) {
      error.show(problem);
    }
    for (const one of buttons) one.disabled = false;
    pressed?.focus();
  };
  const does = (pressed, action) => pressed.addEventListener("click", () => run(action, pressed));
  const keep = () => save(photos[at], boxes.all.map(bare), had.map(bare));
  does(find, seek);
  does(skip, next);
  does(all, async () => {
    await searchAll();
    dialog.close();
  });
  does(send, async () => {
    await keep();
    await next();
  });
  does(rest, async () => {
    while (dialog.open) {
      if (!sought) await seek(); // it failed earlier
      if (dialog.open) await keep();
      if (dialog.open) await next();
    }
  });
  show();
  if (several) run(seek);
  return dialog;
}

/** Message that a model is missing on the server. @param {string} model */
function notSearched(model) {
  const command = `expmap models fetch ${model}`;
  return model === "faces"
    ? t("Faces are not detected: the server needs {command}.", { command })
    : t("Number plates are not detected: the server needs {command}.", { command });
}

/** Message that more was found than a photo can have boxes. @param {number} left */
function notAll(left) {
  return tn("{n} more was found, but the photo cannot have more boxes: draw larger ones.", "{n} more were found, but the photo cannot have more boxes: draw larger ones.", left);
}

/** Kind and confidence of a suggestion. @param {Box} box */
function wordsOf({ kind, score }) {
  const percent = percentText(score);
  return kind === "face" ? t("Face, {percent}", { percent }) : t("Number plate, {percent}", { percent });
}

/** A list of suggestions for a photo; checked ones are among its boxes. */
class Suggestions {
  /** @param {Boxes} boxes */
  constructor(boxes) {
    this.boxes = boxes;
    this.list = h("ul", { class: "blur-found small", "aria-label": t("Suggestions") });
    /** @type {Box[]} */
    this.all = [];
    this.ticks = new Map();
    boxes.onchange = () => this._tick();
  }

  /** @param {Box[]} all */
  show(all) {
    this.all = all;
    this.ticks = new Map(all.map((box) => [box, h("input", { type: "checkbox", onchange: () => this._choose(box) })]));
    this.list.replaceChildren(...all.map((box) => h("li", {}, h("label", {}, this.ticks.get(box), wordsOf(box)))));
    this._tick();
  }

  _tick() {
    for (const [box, input] of this.ticks) input.checked = this.boxes.all.includes(box);
  }

  _choose(box) {
    const others = this.boxes.all.filter((one) => one !== box);
    this.boxes.replace(this.ticks.get(box).checked ? [...others, box] : others);
  }
}

/** Boxes over a picture, drawn with a pointer, or added and moved with keys. */
export class Boxes {
  /**
   * @param {*} frame
   * @param {Object[]} all
   */
  constructor(frame, all) {
    this.frame = frame;
    this.all = all;
    this.count = h("span", { class: "soft small", role: "status" });
    /** Called when boxes were added or removed. */
    this.onchange = () => {};
    preventTextDrag(frame);
    frame.addEventListener("pointerdown", (event) => this._draw(event));
    this._show();
  }

  add(box) {
    this.all.push(box);
    this._show();
    this.frame.querySelector(".blur-box:last-of-type").focus();
  }

  /** Replace all boxes. @param {Object[]} all */
  replace(all) {
    this.all = all;
    this._show();
  }

  _show() {
    for (const old of this.frame.querySelectorAll(".blur-box")) old.remove();
    this.frame.append(...this._shown().map((box) => this._element(box)));
    this.count.textContent = tn("{n} box", "{n} boxes", this.all.length);
    this.onchange();
  }

  /** Boxes that are shown as elements. @returns {Object[]} */
  _shown() {
    return this.all;
  }

  _element(box) {
    const remove = () => {
      this.all.splice(this.all.indexOf(box), 1);
      this._show();
    };
    const button = h("button", { class: "blur-box__remove", type: "button", "aria-label": t("Remove this box"), onclick: remove }, icon("close"));
    const words = t("Box: move it with the arrow keys, resize it with Shift and the arrow keys");
    const made = h("div", { class: "blur-box", tabindex: "0", role: "group", "aria-label": words }, box.kind && h("span", { class: "blur-box__kind", "aria-hidden": "true" }, wordsOf(box)), button);
    made.addEventListener("keydown", (event) => this._key(event, made, box));
    lay(made, box);
    return made;
  }

  _key(event, element, box) {
    const arrow = ARROWS[event.key];
    if (event.key === "Delete") element.querySelector("button").click();
    if (!arrow) return;
    event.preventDefault();
    const [x, y] = arrow.map((by) => by * STEP);
    const changed = event.shiftKey
      ? { ...box, width: box.width + x, height: box.height + y }
      : { ...box, x: Math.min(box.x + x, 1 - box.width), y: Math.min(box.y + y, 1 - box.height) };
    Object.assign(box, inside(changed));
    lay(element, box);
  }

  /** Draw a box by dragging from one corner to the other. */
  _draw(event) {
    if (event.button !== 0 || event.target.closest(".blur-box")) return;
    event.preventDefault();
    this.frame.setPointerCapture(event.pointerId);
    const start = this._at(event);
    const element = h("div", { class: "blur-box" });
    this.frame.append(element);
    let box = { x: start[0], y: start[1], width: 0, height: 0 };
    const move = (moved) => {
      box = between(start, this._at(moved));
      lay(element, box);
    };
    const end = (ended) => {
      for (const [name, run] of [["pointermove", move], ["pointerup", end], ["pointercancel", end]]) this.frame.removeEventListener(name, run);
      element.remove();
      if (ended.type === "pointerup" && Math.min(box.width, box.height) > LEAST) this.add(box);
    };
    for (const [name, run] of [["pointermove", move], ["pointerup", end], ["pointercancel", end]]) this.frame.addEventListener(name, run);
  }

  /** Position as fractions of the picture's width and height. @param {PointerEvent} event */
  _at(event) {
    const { left, top, width, height } = this.frame.getBoundingClientRect();
    const share = (value) => Math.min(Math.max(value, 0), 1);
    return [share((event.clientX - left) / width), share((event.clientY - top) / height)];
  }
}

/** @param {number[]} from @param {number[]} to */
function between([x, y], [toX, toY]) {
  return { x: Math.min(x, toX), y: Math.min(y, toY), width: Math.abs(toX - x), height: Math.abs(toY - y) };
}

/** The saved fields of a box. @param {Box} box */
function bare({ x, y, width, height }) {
  return { x, y, width, height };
}

/** Fraction of a box that another one covers. @param {Box} box @param {Box} other */
function covered(box, other) {
  const side = (from, length) => Math.min(box[from] + box[length], other[from] + other[length]) - Math.max(box[from], other[from]);
  const [width, height] = [side("x", "width"), side("y", "height")];
  return (Math.max(width, 0) * Math.max(height, 0)) / (box.width * box.height);
}

/** Limit a box to the picture and to a minimum size. */
function inside({ x, y, width, height }) {
  const [left, top] = [Math.min(Math.max(x, 0), 1 - LEAST), Math.min(Math.max(y, 0), 1 - LEAST)];
  const side = (length, from) => Math.min(Math.max(length, LEAST), 1 - from);
  return { x: left, y: top, width: side(width, left), height: side(height, top) };
}

function lay(element, { x, y, width, height }) {
  const percent = (value) => `${value * 100}%`;
  Object.assign(element.style, { left: percent(x), top: percent(y), width: percent(width), height: percent(height) });
}
