/** Details behind the answer: matches, distances, times, and the field of view, which can be entered here. */

import { byId, h } from "../shared/dom.js";
import { numberText } from "../shared/format.js";
import { t } from "../shared/i18n.js";
import { term } from "../shared/term.js";

/**
 * @param {import("../shared/answer/query-session.js").QuerySession} session
 * @param {{set: function(string, string): void}} options
 * @param {function(): void} askAgain
 */
export function showExplanation(session, options, askAgain) {
  session.on("answer chosen", () => {
    const { answer } = session;
    if (answer) byId("why").replaceChildren(...rows(session, { options, askAgain }));
  });
}

function rows(session, { options, askAgain }) {
  const { answer, hypothesis } = session;
  const { statistics: counts, seconds } = answer;
  /** @type {Array<[string, string|Node]>} */
  const facts = [[t("Method"), `${answer.method}, ${(answer.looks ?? [answer.features]).join(", ")}`]];
  if (answer.note) facts.push([t("Note"), noteText(answer.note)]);
  if (answer.fov_deg !== null) facts.push([t("Field of view"), fieldOfView(answer, options, askAgain)]);
  facts.push([t("Keypoints"), numberText(counts.keypoints)]);
  facts.push([t("Matches"), t("{n}, {left} left after pruning", { n: numberText(counts.matches), left: numberText(counts.matches_pruned) })]);
  if (hypothesis) {
    const { inliers, matches } = hypothesis;
    facts.push([t("For this place"), inliers === null ? t("{n} matches", { n: matches }) : withTerm(t("{inliers} matching points, of {n} compared", { inliers, n: matches }))]);
    facts.push([t("Photos"), hypothesis.experiences.join(", ")]);
  }
  if (counts.distance_mean !== null) {
    const values = { least: numberText(counts.distance_min, 1), mean: numberText(counts.distance_mean, 1), most: numberText(counts.distance_max, 1) };
    facts.push([t("Distances"), t("{least} to {most}, mean {mean}", values)]);
  }
  facts.push([t("Time"), times(seconds)]);
  facts.push([t("Map revision"), numberText(answer.map_revision)]);
  return facts.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]);
}

function withTerm(text) {
  return h("span", {}, text, " ", term("inliers"));
}

/** Translation of the notes of method `landmarks` when it gives no position. */
function noteText(note) {
  const known = {
    "the landmarks around this place are not reconstructed yet: ask again in a minute": t("The landmarks around this place are being reconstructed. Ask again in a minute."),
    "no place is likely enough to look for landmarks around it": t("No place is likely enough to reconstruct what is around it."),
    "too few landmarks around this place agree with the photo": t("Too few landmarks around this place agree with the photo."),
  };
  const stretched = note.match(/^its contrast was stretched: .* from (\d+) to (\d+)$/);
  if (stretched) return t("The contrast was stretched: nearly all of the 16-bit values are from {low} to {high}.", { low: stretched[1], high: stretched[2] });
  return known[note] ?? note;
}

function times(seconds) {
  const names = { read: t("reading"), extract: t("extracting"), retrieve: t("searching"), verify: t("verifying"), position: t("positioning") };
  const parts = Object.entries(names).filter(([stage]) => seconds[stage] !== null && seconds[stage] !== undefined);
  const values = parts.map(([stage, name]) => `${name} ${numberText(seconds[stage], 2)}`).join(", ");
  return t("{total} s ({parts})", { total: numberText(seconds.total, 2), parts: values });
}

function fieldOfView({ fov_deg, fov_source }, options, askAgain) {
  const values = { n: numberText(fov_deg, 1) };
  if (fov_source === "option") return t("{n}°, as given", values);
  if (fov_source === "exif") return t("{n}°, from the photo", values);
  const input = h("input", {
    class: "input", type: "number", min: 1, max: 179, step: "any", inputmode: "decimal",
    "aria-label": t("Field of view in degrees"), placeholder: String(Math.round(fov_deg)),
  });
  const give = (event) => {
    event.preventDefault();
    if (!input.value || !input.checkValidity()) return;
    options.set("fov", input.value);
    askAgain();
  };
  return h("form", { class: "lo-fov", onsubmit: give },
    h("span", {}, t("{n}°, assumed. Known value:", values)), input, "°",
    h("button", { class: "button", type: "submit" }, t("Ask again")));
}
