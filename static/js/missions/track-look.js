/** How a track looks: name, colour, width and visibility, which editors of the mission set for all who look at it. */

import { busy, errorLine, field, openDialog } from "../shared/dialogs.js";
import { h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { toast, toastError } from "../shared/toast.js";
import { sourceColour, WIDTH_PX } from "./colour-scales.js";
import { trackName, usualName } from "./format.js";

/** Colours that differ on satellite images and for the colour-blind; any other can be mixed. */
const OFFERED = ["#0072b2", "#56b4e9", "#009e73", "#e69f00", "#d55e00", "#cc79a7", "#f0e442", "#e31a1c", "#6a3d9a", "#ffffff"];
const WIDTHS = { min: 1, max: 12, step: 0.5 };
const USUAL = { title: "", colour: null, width_px: null, hidden: false };

/**
 * A button that opens the dialog.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {{mission: Object, track: Object, key: string}} shown
 * @param {Object} props of the button
 * @param {...Node} children
 */
export function lookButton(store, shown, props, ...children) {
  const label = t("Name and colour of {name}", { name: trackName(shown.track) });
  return h("button", { type: "button", title: label, "aria-label": label, "data-testid": "track-look", onclick: () => lookDialog(store, store.track(shown.key) || shown), ...props }, ...children);
}

function lookDialog(store, { mission, track }) {
  const { look } = track;
  const title = h("input", { class: "input", maxlength: 120, value: look.title, placeholder: usualName(track), autocomplete: "off", "data-testid": "track-title" });
  const width = h("input", { class: "mi-slider", type: "range", ...WIDTHS, value: look.width_px ?? WIDTH_PX, "data-testid": "track-width" });
  const shown = h("input", { type: "checkbox", checked: !look.hidden, "data-testid": "track-shown" });
  const sample = h("div", { class: "mi-look__sample", "aria-hidden": "true" }, h("span", {}));
  const colours = colourChoice(look.colour, sourceColour(track.source), () => draw());
  const draw = () => {
    const line = /** @type {HTMLElement} */ (sample.firstElementChild);
    line.style.background = colours.value() ?? sourceColour(track.source);
    line.style.height = `${width.value}px`;
  };
  width.addEventListener("input", draw);
  draw();
  const error = errorLine();
  const send = (fields) => async (event) => {
    error.show(null);
    await busy(event.currentTarget, async () => {
      try {
        await change(store, { mission, track }, fields(), () => dialog.close());
      } catch (problem) {
        if (problem.status === undefined && problem.code !== "offline") throw problem;
        error.show(problem);
      }
    });
  };
  const chosen = () => changed(look, {
    title: title.value.trim(), colour: colours.value(), hidden: !shown.checked,
    width_px: Number(width.value) === WIDTH_PX ? null : Number(width.value),
  });
  const reset = h("button", { class: "button", type: "button", disabled: !Object.keys(changed(look, USUAL)).length, onclick: send(() => changed(look, USUAL)) }, t("Reset"));
  const save = h("button", { class: "button button--primary", type: "button", "data-testid": "track-look-save", onclick: send(chosen) }, t("Save"));
  const dialog = openDialog(usualName(track), [
    h("p", { class: "soft small" }, t("For all who look at this mission, and in exports.")),
    field(t("Name"), title),
    colours.element,
    field(t("Line width"), width),
    sample,
    h("label", { class: "check" }, shown, h("span", {}, t("Show it when the page opens"))),
    error,
  ], { actions: [reset, save], cancels: true });
  title.addEventListener("keydown", (event) => event.key === "Enter" && save.click());
  title.focus();
}

/** The fields of a look that differ. */
function changed(look, wanted) {
  return Object.fromEntries(Object.entries(wanted).filter(([name, value]) => look[name] !== value));
}

/** Change a look on the server, with an offer to undo. @param {function(): void} [done] before the page shows it */
async function change(store, { mission, track }, fields, done = () => {}) {
  if (!Object.keys(fields).length) return done();
  const before = Object.fromEntries(Object.keys(fields).map((name) => [name, track.look[name]]));
  const received = await store.server(mission.id).setLook(track.id, fields);
  done();
  store.setLook(mission.id, received);
  const undo = () => change(store, { mission, track: received }, before).catch(toastError);
  toast(t("{name} was changed", { name: trackName(received) }), { action: { label: t("Undo"), run: undo } });
}

/**
 * Radio buttons for a colour.
 * @param {?string} known that is set
 * @param {string} usual without one
 * @param {function(): void} onchange
 */
function colourChoice(known, usual, onchange) {
  const mixed = h("input", { type: "color", value: known ?? usual, "aria-label": t("Any colour"), "data-testid": "track-colour" });
  const radio = (value, checked, ...look) => h("label", { class: "mi-look__colour" }, h("input", { type: "radio", name: "track-colour", value, checked, onchange }), ...look);
  const swatch = (colour) => {
    const made = h("span", { class: "mi-look__swatch", "aria-hidden": "true" });
    made.style.background = colour;
    return made;
  };
  const other = known !== null && !OFFERED.includes(known);
  const last = radio("mixed", other, h("span", {}, t("Other")));
  mixed.addEventListener("input", () => {
    last.querySelector("input").checked = true;
    onchange();
  });
  const element = h("fieldset", { class: "mi-look__colours" },
    h("legend", {}, t("Colour")),
    radio("", known === null, swatch(usual), h("span", {}, t("As usual"))),
    ...OFFERED.map((colour) => radio(colour, colour === known, swatch(colour), h("span", { class: "visually-hidden" }, nameOf(colour)))),
    last, mixed);
  const value = () => {
    const chosen = /** @type {HTMLInputElement} */ (element.querySelector("[type=radio]:checked")).value;
    return chosen === "mixed" ? mixed.value : chosen || null;
  };
  return { element, value };
}

function nameOf(colour) {
  const names = [t("Blue"), t("Light blue"), t("Green"), t("Orange"), t("Vermilion"), t("Pink"), t("Yellow"), t("Red"), t("Purple"), t("White")];
  return names[OFFERED.indexOf(colour)];
}
