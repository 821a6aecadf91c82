/** States of an object as a task, and the buttons that set the next one. */

import { h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";
import { clockText } from "./format.js";

/** Possible next states, the usual one first. */
const NEXT = {
  found: ["confirmed", "dismissed"],
  confirmed: ["cleared", "dismissed"],
  cleared: ["found"],
  dismissed: ["found"],
};

/** Whether an object still needs work. */
export const isOpen = ({ state }) => state === "found" || state === "confirmed";

export function stateName(state) {
  return { found: t("Found"), confirmed: t("Confirmed"), cleared: t("Cleared"), dismissed: t("Dismissed") }[state] || state;
}

function actionName(state) {
  return { found: t("Reopen"), confirmed: t("Confirm"), cleared: t("Clear"), dismissed: t("Dismiss") }[state];
}

/** The state as a badge. */
export function stateBadge(state) {
  const look = { confirmed: "badge badge--accent", cleared: "badge badge--success" }[state] || "badge";
  return h("span", { class: look, "data-testid": "object-state" }, stateName(state));
}

/** Who set the state, and when; empty if it was never set. */
export function stateText({ state_by: by, state_time_s: time }) {
  if (time === null || time === undefined) return "";
  return by ? t("{name}, {time}", { name: by, time: clockText(time) }) : clockText(time);
}

/**
 * The buttons that set the next state; none without permission to edit.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {Object} object
 * @param {?HTMLInputElement} [note] text for the history; cleared when it is saved
 */
export function stateButtons(store, object, note = null) {
  if (!store.missions.get(object.mission)?.can_edit) return [];
  return (NEXT[object.state] || []).map((state, n) =>
    h("button", {
      class: n ? "button button--quiet" : "button button--primary",
      type: "button",
      dataset: { state },
      "aria-label": t("{action}: {name}", { action: actionName(state), name: object.id }),
      onclick: (event) => set(store, object, { state, note, button: event.currentTarget }),
    }, actionName(state)));
}

async function set(store, object, { state, note, button }) {
  const server = store.server(object.mission);
  button.disabled = true;
  try {
    const changed = await server.setState(object.id, { state, was: object.state, note: note ? note.value.trim() : "" });
    if (note) note.value = "";
    store.setObjects(object.mission, [changed]);
  } catch (error) {
    toastError(error);
    button.disabled = false;
    if (error.status === 409) store.setObjects(object.mission, [await server.object(object.id)]);
  }
}
