/** The dialog to correct times of a wrong camera clock: one is set, the others shift by the same amount. */

import { field, openDialog } from "../../shared/dialogs.js";
import { h } from "../../shared/dom.js";
import { t, tn } from "../../shared/i18n.js";

/**
 * Shift local times, without daylight saving changes: a camera clock has none.
 * @param {Array<{id: number, taken_at: ?string}>} photos
 * @param {string} right time of the first of them, such as 2026-05-31T14:05:00
 * @returns {Map<number, string>} new times by id, for photos with a time
 */
export function shiftedTimes(photos, right) {
  const timed = photos.filter(({ taken_at: taken }) => taken);
  if (!timed.length) return new Map();
  const shift = seconds(right) - seconds(timed[0].taken_at);
  return new Map(timed.map(({ id, taken_at: taken }) => [id, text(seconds(taken) + shift) + offset(taken)]));
}

/**
 * Ask for the right time of the first photo, and shift all.
 * @param {import("../commands.js").Commands} commands
 * @param {number[]} ids by time
 */
export function timeDialog(commands, ids) {
  const photos = ids.map((id) => commands.store.photos.get(id)).filter(({ taken_at: taken }) => taken);
  const [first] = photos;
  const now = first.taken_at.slice(0, 19);
  const right = h("input", { class: "input", type: "datetime-local", step: 1, value: now, required: true, "data-testid": "right-time" });
  const shift = h("p", { class: "soft", role: "status" });
  const explain = () => {
    const by = right.value ? seconds(right.value) - seconds(now) : 0;
    shift.textContent = tn("{n} photo is shifted by {shift}.", "{n} photos are shifted by {shift}.", photos.length, { shift: signed(by) });
  };
  right.addEventListener("input", explain);
  explain();
  const set = h("button", { class: "button button--primary", type: "button" }, t("Correct the times"));
  const title = tn("Time of {n} photo", "Times of {n} photos", photos.length);
  const dialog = openDialog(title, [
    h("p", {}, t("When was {name} really taken? The others shift by the same amount. The files do not change.", { name: first.name })),
    field(t("Right time"), right),
    shift,
  ], { actions: [set] });
  set.addEventListener("click", () => {
    if (!right.reportValidity()) return;
    if (seconds(right.value) !== seconds(now)) commands.retime(shiftedTimes(photos, right.value));
    dialog.close();
  });
}

/** Seconds of a local time as if it were UTC, so that no hour is skipped or repeated. */
function seconds(local) {
  return Date.parse(`${local.slice(0, 19)}Z`) / 1000;
}

function text(time) {
  return new Date(time * 1000).toISOString().slice(0, 19);
}

/** The UTC offset at the end of a time, which is kept. */
function offset(time) {
  return /(Z|[+-]\d\d:\d\d)$/.exec(time)?.[0] ?? "";
}

/** A shift as text, such as +01:02:00, with days if any. */
function signed(shift) {
  const [size, sign] = [Math.abs(shift), shift < 0 ? "−" : "+"];
  const [days, rest] = [Math.floor(size / 86400), size % 86400];
  const clock = [rest / 3600, (rest % 3600) / 60, rest % 60].map((part) => String(Math.floor(part)).padStart(2, "0")).join(":");
  return `${sign}${days ? `${tn("{n} day", "{n} days", days)} ` : ""}${clock}`;
}
