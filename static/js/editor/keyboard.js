/** Keyboard shortcuts for all actions. */

import { takesText } from "../shared/dom.js";
import { singleKeys } from "../shared/single-keys.js";
import { openViewer } from "./photos/photo-viewer.js";

const STEP = 8;
const FAST_STEP = 48;
const TURN_DEG = 5;
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/**
 * Listen to keys.
 * @param {{view: Object, dots: Object, gestures: Object, crosshair: Object, measure: Object, northUp: Object, commands: Object, help: function(): void}} page
 */
export function connectKeyboard(page) {
  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || takesText(event.target) || document.querySelector("dialog[open]")) return;
    const typed = event.getModifierState("AltGraph"); // how some keyboards write [ and ]
    const control = (event.ctrlKey || event.metaKey) && !typed;
    const run = control ? withControl(event, page) : plain(event, page, typed);
    if (!run) return;
    event.preventDefault();
    run();
  });
}

function withControl(event, { commands }) {
  const key = event.key.toLowerCase();
  if (event.altKey) return null;
  if (key === "z") return () => commands.history(event.shiftKey ? "redo" : "undo");
  if (key === "y") return () => commands.history("redo");
  return null;
}

function plain(event, page, typed) {
  if (event.altKey && !typed) return null;
  const onMap = event.target === page.view.element;
  return (onMap && onImage(event, page)) || anywhere(event, page) || (singleKeys.on ? single(event, page) : null);
}

/** Keys that act only while the image has the focus. */
function onImage(event, { crosshair, commands, view, dots, measure }) {
  const { store } = commands;
  const arrow = ARROWS[event.key];
  const step = event.shiftKey ? FAST_STEP : STEP;
  if (arrow) return () => crosshair.move(arrow[0] * step, arrow[1] * step);
  if (event.key === "+" || event.key === "=") return () => view.zoom(0.5);
  if (event.key === "-") return () => view.zoom(-0.5);
  if (!crosshair.visible || !store.satellite) return null;
  const [under] = dots.near(crosshair.point).filter((id) => id !== store.currentId);
  if (event.key === " ") return () => under !== undefined && store.toggleSelected(under);
  if (event.key !== "Enter") return null;
  if (measure.active) return () => measure.add(crosshair.pixel);
  const choose = store.tool === "select" && under !== undefined;
  return () => (choose ? store.setCurrent(under) : commands.placeCurrent(crosshair.pixel));
}

function anywhere(event, { commands, dots, gestures, measure }) {
  const { store } = commands;
  if (event.target.closest?.("details.menu, input[type=range]") && event.key !== "Escape") return null;
  if (event.key === "Delete" && store.canEdit) return () => commands.remove(commands.chosen());
  if (event.key === "Backspace" && store.canEdit) return () => commands.toTray(commands.chosen());
  if (event.key !== "Escape") return null;
  return () => {
    if (gestures.gesture) gestures.cancel();
    else if (measure.active) measure.stop();
    else if (dots.isFanned) dots.fan([]);
    else if (store.selection.size) store.setSelection([]);
    else store.setTool("select");
  };
}

function single(event, { commands, view, measure, northUp, help }) {
  const { store } = commands;
  const position = store.currentId === null ? null : store.position(store.currentId);
  const actions = {
    n: () => commands.step(1),
    p: () => commands.step(-1),
    "[": () => commands.turnBy(-TURN_DEG),
    "]": () => commands.turnBy(TURN_DEG),
    ",": () => commands.turnBy(-TURN_DEG),
    ".": () => commands.turnBy(TURN_DEG),
    "+": () => view.zoom(0.5),
    "=": () => view.zoom(0.5),
    "-": () => view.zoom(-0.5),
    0: () => view.fit(),
    c: () => position && view.reveal(position, { margin: 120 }),
    m: () => view.element.focus(),
    f: () => openViewer(commands),
    u: () => northUp.toggle(),
    d: () => store.satellite && measure.toggle(),
    "?": help,
  };
  return actions[event.key.toLowerCase()] || null;
}
