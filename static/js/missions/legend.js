/** Legend of the colours of the tracks. */

import { byId, h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { nthColour, SCALE, sourceColour } from "./colour-scales.js";
import { clockText, DAY_S, sourceName, spanText, speedText, timeText } from "./format.js";

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
  const render = () => {
    const several = store.missions.size > 1;
    choice.querySelector("[value=mission]").toggleAttribute("hidden", !several);
    if (!several && store.mode === "mission") {
      choice.value = "source";
      store.setMode("source");
      return;
    }
    const parts = store.shown.length ? content(store, lines) : [];
    box.replaceChildren(...parts);
  };
  store.on("missions shown mode grown fixes", render);
  lines.addEventListener("change", render);
  render();
}

function content(store, lines) {
  if (store.mode === "speed") return scale("0", speedText(lines.fastest));
  if (store.mode === "time" && store.clock) {
    const { first, span, aligned } = store.clock;
    const textOf = span < DAY_S ? timeText : clockText;
    return aligned ? scale("0:00", spanText(span)) : scale(textOf(first), textOf(first + span));
  }
  if (store.mode === "mission") {
    return [...store.missions.values()].map(({ name }, n) => entry(nthColour(n), name));
  }
  const sources = new Set(store.shown.map(({ track }) => track.source));
  const left = store.fixes.some(({ gated }) => gated) && h("span", { class: "mi-legend__entry" }, h("span", { class: "mi-legend__cross", "aria-hidden": "true" }, "×"), t("Left out"));
  return [...[...sources].map((source) => entry(sourceColour(source), sourceName(source))), left].filter(Boolean);
}

function entry(colour, name) {
  const line = h("span", { class: "mi-legend__line", "aria-hidden": "true" });
  line.style.background = colour;
  return h("span", { class: "mi-legend__entry" }, line, name);
}

function scale(low, high) {
  const bar = h("span", { class: "mi-legend__scale", "aria-hidden": "true" });
  bar.style.backgroundImage = `linear-gradient(to right, ${SCALE.filter((_, n) => n % 4 === 0).join(", ")}, ${SCALE.at(-1)})`;
  return [h("span", {}, low), bar, h("span", {}, high)];
}
