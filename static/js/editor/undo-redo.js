/** Undo and redo buttons with the name of the step, and the state of saving. */

import { byId } from "../shared/dom.js";
import { labelled, t, tn } from "../shared/i18n.js";
import { toast } from "../shared/toast.js";
import { WRITTEN } from "../shared/written-facts.js";

/** Names of edits for the buttons. */
const KINDS = {
  place: (n) => tn("placing {n} photo", "placing {n} photos", n),
  move: (n) => tn("moving {n} photo", "moving {n} photos", n),
  turn: (n) => tn("turning {n} photo", "turning {n} photos", n),
  retime: (n) => tn("correcting the time of {n} photo", "correcting the times of {n} photos", n),
  panorama: (n) => tn("changing {n} panorama", "changing {n} panoramas", n),
  unplace: (n) => tn("moving {n} photo back to the tray", "moving {n} photos back to the tray", n),
  remove: (n) => tn("removing {n} photo", "removing {n} photos", n),
  "place-gps": (n) => tn("placing {n} photo by GPS", "placing {n} photos by GPS", n),
  "place-file": (n) => tn("placing {n} photo by a list", "placing {n} photos by a list", n),
  "place-gpx": (n) => tn("placing {n} photo by a track", "placing {n} photos by a track", n),
  "place-rest": (n) => tn("placing {n} photo by the others", "placing {n} photos by the others", n),
  placement: () => t("the change to the placement"),
  fix: (n) => tn("correcting {n} photo", "correcting {n} photos", n),
  note: (n) => tn("the note on {n} photo", "the notes on {n} photos", n),
  notes: () => t("the change of a note"),
  floor: (n) => tn("moving {n} photo to another floor", "moving {n} photos to another floor", n),
  floors: () => t("the change of a floor"),
  "control-points": () => t("the change of a control point"),
  satellite: () => t("the new image"),
  georeference: () => t("the new position of the image"),
};

/**
 * Connect the buttons and the line about saving.
 * @param {import("./commands.js").Commands} commands
 */
export function connectUndoRedo(commands) {
  const { store, edits } = commands;
  const [undo, redo] = [byId("undo", HTMLButtonElement), byId("redo", HTMLButtonElement)];
  undo.addEventListener("click", () => commands.history("undo"));
  redo.addEventListener("click", () => commands.history("redo"));
  const render = () => {
    label(undo, t("Undo"), store.history.undo, "Ctrl+Z");
    label(redo, t("Redo"), store.history.redo, "Ctrl+Shift+Z");
    undo.disabled = !store.history.undo && !edits.waiting;
    redo.disabled = !store.history.redo || edits.waiting > 0;
    saved(edits);
  };
  store.on("history", render);
  edits.addEventListener("change", render);
  edits.addEventListener("refused", (event) => {
    const { message, hint } = /** @type {CustomEvent} */ (event).detail;
    toast(message, { kind: "error", hint });
  });
  store.on("people", () => people(store.people));
  render();
}

/** Name of an edit. @param {{kind: string, count: ?number}} step */
export function stepName({ kind, count }) {
  const n = count ?? 1;
  const fact = WRITTEN.find((one) => one.kind === kind)?.label;
  if (KINDS[kind]) return KINDS[kind](n);
  return fact ? tn("“{fact}” of {n} photo", "“{fact}” of {n} photos", n, { fact }) : t("the last change");
}

function label(button, word, step, keys) {
  const what = step ? stepName(step) : "";
  const text = what ? labelled(word, what) : word;
  button.title = `${text} (${keys})`;
  button.setAttribute("aria-label", text);
}

let timer = 0;

/** Show the number of unsaved edits, but not during the short time of a normal save. */
function saved(edits) {
  const line = byId("saved");
  clearTimeout(timer);
  line.dataset.waiting = edits.waiting;
  const show = () => {
    const waiting = edits.waiting > 0;
    line.classList.toggle("is-waiting", waiting);
    line.textContent = waiting ? t("Not saved yet: {n}", { n: edits.waiting }) : "";
  };
  if (!edits.waiting || edits.failures || line.textContent) show();
  else timer = setTimeout(show, 1500);
}

function people(names) {
  const line = byId("people");
  line.textContent = names.length > 1 ? tn("{n} person here", "{n} people here", names.length) : "";
  line.title = names.join(", ");
}
