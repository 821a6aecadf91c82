/** The answer as a list: each place with its probability, and "not on this map" as a separate entry. */

import { byId, h, icon, queryAll, takesText } from "../dom.js";
import { headingText, lengthText, percentText } from "../format.js";
import { t, tn } from "../i18n.js";
import { probabilityColours } from "./answer-format.js";
import { isOffMap, ranking } from "./query-session.js";
import { isFaint, isMinor, verdictText } from "./verdict.js";

const calm = matchMedia("(prefers-reduced-motion: reduce)");

/** Photos of other places seldom reach as many inliers. */
const STRONG_INLIERS = 30;

/**
 * @param {import("./query-session.js").QuerySession} session
 * @param {function(): void} look brings the chosen place into view
 */
export function answerList(session, look) {
  const list = byId("hypotheses");
  const verdict = h("p", { class: "lo-verdict", id: "verdict" });
  const shares = h("p", { class: "lo-shares small soft", id: "shares" });
  list.before(verdict, shares);
  session.on("answer", () => {
    const { answer } = session;
    byId("answer").hidden = !answer;
    verdict.textContent = answer ? verdictText(answer) : "";
    shares.textContent = answer ? sharesText(answer) : "";
    list.replaceChildren(...(answer ? entries(answer, (rank) => (session.choose(rank), look())) : []));
    mark(list, session);
    if (answer) requestAnimationFrame(() => scrollTo(list.querySelector("li") || verdict));
  });
  session.on("chosen spot", () => mark(list, session));
  list.addEventListener("keydown", (event) => {
    const by = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!by) return;
    const buttons = queryAll("li:not([hidden]) button", HTMLElement, list);
    buttons[buttons.findIndex((button) => button === document.activeElement) + by]?.focus();
    event.preventDefault();
  });
}

/** Scroll to an answer that has arrived below the visible part, unless somebody is writing. @param {Element} answer */
function scrollTo(answer) {
  if (!takesText(document.activeElement)) answer.scrollIntoView({ block: "nearest", behavior: calm.matches ? "auto" : "smooth" });
}

/** What the numbers of the list are of. */
function sharesText({ method, verdict, hypotheses }) {
  if (verdict === "nothing_to_see" || !hypotheses.length) return "";
  return method === "vote" ? t("Share of the matches") : t("Probability that it was taken there");
}

function mark(list, session) {
  for (const item of list.querySelectorAll("[data-rank]")) {
    const chosen = Number(item.dataset.rank) === session.chosen;
    item.firstElementChild.setAttribute("aria-pressed", String(chosen));
    if (chosen && item.hidden) unfold(list);
  }
}

function entries(answer, choose) {
  const { hypotheses, off_map_probability: off } = answer;
  if (answer.verdict === "nothing_to_see") return [];
  if (off === null && !hypotheses.length) return [offMap(null, true)];
  const made = {
    place: (at) => entry(hypotheses[at], { choose, faint: isFaint(answer, hypotheses[at].probability) }),
    off: () => offMap(off, isOffMap(answer)),
    other: () => others(answer.other_probability),
  };
  const items = ranking(answer).map(({ kind, at }) => made[kind](at));
  const minor = items.filter(({ dataset }) => dataset.rank && isMinor(answer, Number(dataset.probability)));
  if (minor.length > 1) fold(minor, items);
  return items;
}

/** Fold several improbable places into one line. */
function fold(minor, items) {
  const text = tn("{n} more, less than 5 %", "{n} more, each less than 5 %", minor.length);
  const button = h("button", { class: "lo-place lo-place--rest small soft", type: "button", onclick: () => {
    unfold(item.parentElement);
    minor[0].querySelector("button").focus();
  } }, text);
  const item = h("li", { "data-testid": "folded", dataset: { folded: "" } }, button);
  items.splice(items.indexOf(minor[0]), 0, item);
  for (const place of minor) place.hidden = true;
}

function unfold(list) {
  list.querySelector("[data-folded]")?.remove();
  for (const item of list.children) item.hidden = false;
}

function entry(hypothesis, { choose, faint }) {
  const { rank, probability, x_px, y_px } = hypothesis;
  const { fill, text } = probabilityColours(probability);
  const number = h("span", { class: "lo-number", "aria-hidden": "true" }, String(rank));
  if (faint) number.classList.add("lo-number--faint");
  else Object.assign(number.style, { backgroundColor: fill, color: text });
  const button = h(
    "button",
    { class: "lo-place", type: "button", "aria-pressed": "false", onclick: () => choose(rank) },
    number,
    h("span", { class: "lo-place__text" },
      h("span", { class: "lo-place__what" }, kindText(hypothesis)),
      h("span", { class: "small soft" }, ...details(hypothesis))),
    h("span", { class: "lo-place__share" }, percentText(probability), bar(probability, fill)),
  );
  const data = { rank, x: x_px, y: y_px, probability };
  return h("li", { "data-testid": "hypothesis", dataset: data }, button);
}

/** @param {{kind?: string, rank?: number}} hypothesis */
export function placeName({ kind, rank }) {
  return kind === "area" ? t("Area {n}", { n: rank }) : t("Place {n}", { n: rank });
}

function kindText(hypothesis) {
  const { radius_m, radius_px } = hypothesis;
  return radius_px === null ? placeName(hypothesis) : `${placeName(hypothesis)} ± ${lengthText(radius_m, radius_px)}`;
}

function details({ kind, experiences, floor_name, heading_deg, inliers, matches }) {
  const what = {
    position: () => tn("computed from {n} photo", "computed from {n} photos", experiences.length),
    area: () => tn("like {n} photo of the area", "like {n} photos of the area", experiences.length),
    photo: () => t("near one photo"),
  };
  const parts = [...(floor_name ? [floor_name, " · "] : []), (what[kind] || what.photo)(), " · ", inliers === null ? tn("{n} match", "{n} matches", matches) : strength(inliers)];
  if (heading_deg !== null) parts.push(" · ", t("facing {heading}", { heading: headingText(heading_deg) }));
  return parts;
}

function strength(inliers) {
  const text = inliers >= STRONG_INLIERS ? t("strong match") : t("weak match");
  return h("span", { title: tn("{n} matching point", "{n} matching points", inliers) }, text);
}

function offMap(probability, likely) {
  const known = probability !== null;
  const what = known ? t("Not on this map") : t("No match found");
  return h(
    "li",
    { "data-testid": "off-map", dataset: known ? { probability } : {} },
    h("div", { class: `lo-place lo-place--off${likely ? " is-likely" : ""}` },
      h("span", { class: "lo-number lo-number--off", "aria-hidden": "true" }, icon("off-map")),
      h("span", { class: "lo-place__text" }, h("span", { class: "lo-place__what" }, what)),
      known && h("span", { class: "lo-place__share" }, percentText(probability), bar(probability, null))),
  );
}

function others(probability) {
  return h("li", { class: "lo-place lo-place--rest small soft" },
    h("span", { class: "lo-place__text" }, t("other places")),
    h("span", { class: "lo-place__share" }, percentText(probability)));
}

function bar(probability, fill) {
  const inner = h("span", { class: "lo-bar__fill" });
  inner.style.width = `${Math.max(probability * 100, 2)}%`;
  if (fill) inner.style.backgroundColor = fill;
  return h("span", { class: "lo-bar", "aria-hidden": "true" }, inner);
}
