/** Legend: the colours of the tracks and the classes of the objects; a click on a track changes how it looks. */

import { byId, h } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { rafThrottle } from "../shared/timing.js";
import { nthColour, SCALE, trackColour, WIDTH_PX } from "./colour-scales.js";
import { clockText, DAY_S, spanText, speedText, timeText, trackName } from "./format.js";
import { lookButton } from "./track-look.js";

const MOST_TRACKS = 12;
const MOST_KINDS = 12;
const SMALL = "(max-width: 47.99rem)";

/**
 * Keep the legend up to date.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {import("./track-lines.js").TrackLines} lines
 */
export function showLegend(store, lines) {
  const box = byId("legend");
  const choice = byId("colour-by", HTMLSelectElement);
  choice.value = store.mode;
  choice.addEventListener("change", () => store.setMode(choice.value));
  let known = "";
  const render = () => {
    const several = store.missions.size > 1;
    choice.querySelector("[value=mission]").toggleAttribute("hidden", !several);
    if (!several && store.mode === "mission") {
      choice.value = "source";
      store.setMode("source");
      return;
    }
    const made = h("div", {}, ...(store.shown.length ? tracks(store, lines) : []), ...kinds(store));
    if (made.innerHTML === known) return; // new poses change nothing here
    known = made.innerHTML;
    const focused = box.contains(document.activeElement) && document.activeElement.id;
    box.replaceChildren(...made.childNodes);
    if (focused) document.getElementById(focused)?.focus();
  };
  const soon = rafThrottle(render);
  store.on("missions shown mode grown fixes objects", soon);
  lines.addEventListener("change", soon);
  render();
  toggle(box);
}

/** A small map keeps its legend folded until it is wanted. @param {HTMLElement} box */
function toggle(box) {
  const button = byId("legend-toggle");
  const show = (open) => {
    button.setAttribute("aria-expanded", String(open));
    box.hidden = !open;
  };
  button.addEventListener("click", () => show(box.hidden));
  show(!matchMedia(SMALL).matches);
}

function tracks(store, lines) {
  if (store.mode === "speed") return [scale("0", speedText(lines.fastest))];
  if (store.mode === "time" && store.clock) {
    const { first, span, aligned } = store.clock;
    const textOf = span < DAY_S ? timeText : clockText;
    return [aligned ? scale("0:00", spanText(span)) : scale(textOf(first), textOf(first + span))];
  }
  if (store.mode === "mission") {
    return [...store.missions.values()].map(({ name }, n) => h("span", { class: "mi-legend__entry" }, sample(nthColour(n), WIDTH_PX), name));
  }
  const { shown } = store;
  const left = store.fixes.some(({ gated }) => gated) && h("span", { class: "mi-legend__entry" }, h("span", { class: "mi-legend__cross", "aria-hidden": "true" }, "×"), t("Left out"));
  return [...shown.slice(0, MOST_TRACKS).map((one) => entry(store, one)), more(shown.length - MOST_TRACKS), left].filter(Boolean);
}

function entry(store, one) {
  const { mission, track, key } = one;
  const line = sample(trackColour(store, one), track.look?.width_px ?? WIDTH_PX);
  const name = h("span", { class: "mi-legend__name" }, trackName(track));
  if (!mission.can_edit) return h("span", { class: "mi-legend__entry" }, line, name);
  return lookButton(store, one, { class: "mi-legend__entry mi-legend__track", id: `legend-${key.replace("/", "-")}` }, line, name);
}

/** The classes of the objects, the most frequent first. */
function kinds(store) {
  const counts = new Map();
  for (const { kind } of store.objects.values()) counts.set(kind, (counts.get(kind) || 0) + 1);
  const sorted = [...counts].sort(([a, n], [b, m]) => m - n || a.localeCompare(b));
  const shown = sorted.slice(0, MOST_KINDS).map(([kind, count]) => h("span", { class: "mi-legend__entry" },
    store.symbols.element(kind), h("span", { class: "mi-legend__name" }, kind), h("span", { class: "soft" }, count)));
  return [...shown, more(sorted.length - MOST_KINDS)].filter(Boolean);
}

function more(count) {
  return count > 0 && h("span", { class: "soft" }, tn("{n} more", "{n} more", count));
}

function sample(colour, width) {
  const line = h("span", { class: "mi-legend__line", "aria-hidden": "true" });
  line.style.background = colour;
  line.style.height = `${width}px`;
  return line;
}

function scale(low, high) {
  const bar = h("span", { class: "mi-legend__bar", "aria-hidden": "true" });
  bar.style.backgroundImage = `linear-gradient(to right, ${SCALE.filter((_, n) => n % 4 === 0).join(", ")}, ${SCALE.at(-1)})`;
  return h("span", { class: "mi-legend__scale" }, h("span", {}, low), bar, h("span", {}, high));
}
