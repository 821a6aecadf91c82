/** The robots of the mission: battery, mode and message, when each was last heard, and the alarm for silent ones. */

import { byId, h } from "../shared/dom.js";
import { locale, t } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";
import { clockText, numberText, spanText } from "./format.js";

/** New poses come every second or so: robots are asked for at most this often. */
const CALM_MS = 3000;
const TICK_MS = 1000;
/** Below this a battery is pointed out. */
const LOW_PERCENT = 20;

const ago = new Intl.RelativeTimeFormat(locale, { numeric: "always", style: "short" });

/** Keep the list up to date. @param {import("./mission-store.js").MissionStore} store */
export function showRobots(store) {
  const server = store.server(store.id);
  const choice = /** @type {?HTMLSelectElement} */ (document.getElementById("silent-after"));
  let known = { clock_s: 0, silent_after_s: null, robots: [], silences: [] };
  let offset = 0;
  let waiting = 0;
  const render = () => draw(known, { now: Date.now() / 1000 + offset, ended: Boolean(store.mission.ended_at) });
  const load = async () => {
    waiting = 0;
    try {
      known = await server.robots();
    } catch (error) {
      if (error.status === undefined) throw error; // the next change asks again
      return;
    }
    offset = known.clock_s - Date.now() / 1000;
    if (choice && document.activeElement !== choice) show(choice, known.silent_after_s);
    render();
  };
  const ask = () => (waiting ||= setTimeout(load, CALM_MS));
  store.on("missions grown", ask);
  choice?.addEventListener("change", async () => {
    try {
      await server.change({ silent_after_s: choice.value ? Number(choice.value) : null });
      await load();
    } catch (error) {
      toastError(error);
      show(choice, known.silent_after_s);
    }
  });
  setInterval(render, TICK_MS);
  load();
}

/** Select a time; one that programs have set, and which is not offered, is added. */
function show(choice, seconds) {
  const value = seconds === null ? "" : String(seconds);
  if (![...choice.options].some((option) => option.value === value)) choice.append(new Option(spanText(seconds), value));
  choice.value = value;
}

function draw({ silent_after_s: limit, robots, silences }, { now, ended }) {
  byId("robots").hidden = !robots.length;
  const isSilent = (robot) => limit !== null && !ended && now - robot.heard_time_s > limit;
  const silent = robots.filter(isSilent);
  const alarm = silent.length ? t("Silent: {names}", { names: silent.map(nameOf).join(", ") }) : "";
  const box = byId("silent-state");
  if (box.textContent !== alarm) box.textContent = alarm; // announced only when it changes
  byId("robot-list").replaceChildren(...robots.map((robot) => item(robot, { now, silent: isSilent(robot) })));
  const over = silences.filter(({ until_s: until }) => until !== null);
  const log = [...silent.map((robot) => ({ robot: robot.name, since_s: robot.heard_time_s, until_s: null })), ...over];
  byId("silences-part").hidden = !log.length;
  byId("silences").replaceChildren(...log.map((one) => h("li", {}, silenceText(one))));
}

function item(robot, { now, silent }) {
  const seconds = Math.max(0, now - robot.heard_time_s);
  const look = silent ? "badge badge--danger" : "badge";
  return h("li", { class: "mi-robot", "data-testid": "robot" },
    h("div", { class: "mi-robot__head" },
      h("strong", {}, nameOf(robot)),
      h("span", { class: look, "data-testid": "heard" }, t("last heard {ago}", { ago: agoText(seconds) }))),
    robot.status && h("p", { class: "small" }, ...statusParts(robot.status)));
}

function statusParts({ battery_percent: battery, link_percent: link, mode, text }) {
  const low = battery !== null && battery < LOW_PERCENT;
  const parts = [
    battery !== null && h("span", { class: low ? "badge badge--danger" : "" }, t("Battery {n} %", { n: numberText(battery) })),
    link !== null && t("Link {n} %", { n: numberText(link) }),
    mode,
    text,
  ].filter(Boolean);
  return parts.flatMap((part, n) => (n ? [" · ", part] : [part]));
}

/** @param {number} seconds */
function agoText(seconds) {
  if (seconds < 60) return ago.format(-Math.round(seconds), "second");
  if (seconds < 3600) return ago.format(-Math.floor(seconds / 60), "minute");
  if (seconds < 86400) return ago.format(-Math.floor(seconds / 3600), "hour");
  return ago.format(-Math.floor(seconds / 86400), "day");
}

function silenceText({ robot, since_s: since, until_s: until }) {
  const facts = { name: nameOf({ name: robot }), since: clockText(since) };
  if (until === null) return t("{name}: silent since {since}", facts);
  return t("{name}: silent from {since} for {span}", { ...facts, span: spanText(until - since) });
}

function nameOf({ name }) {
  return name || t("Robot");
}
