/** Colours of tracks: those that people set, by source, mission, time or speed; safe for colour blindness. */

const SOURCES = { gps: "#0072b2", odometry: "#e69f00", visual: "#cc79a7", fused: "#009e73", manual: "#56b4e9" };
const OTHERS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442"];
const STOPS = ["#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58", "#b5de2b", "#fde725"];

/** Number of colours of a scale. */
export const STEPS = 48;

/** Colours of a quantity, the lowest first (viridis: perceptually uniform). */
export const SCALE = Array.from({ length: STEPS }, (_, n) => between(n / (STEPS - 1)));

/** Colour of a source. */
export const sourceColour = (source) => SOURCES[source] || "#999999";

/** Colour of the n-th item. */
export const nthColour = (n) => OTHERS[n % OTHERS.length];

/** Width of a line unless another is set, pixels. */
export const WIDTH_PX = 3.5;

/**
 * Colour of a track where it is one colour: that of its mission if so chosen, else its own.
 * @param {import("./mission-store.js").MissionStore} store
 * @param {{mission: Object, track: Object}} shown
 */
export function trackColour(store, { mission, track }) {
  if (store.mode === "mission") return nthColour([...store.missions.keys()].indexOf(mission.id));
  return track.look?.colour ?? sourceColour(track.source);
}

/** Step of the scale for a value. */
export function stepOf(value, [low, high]) {
  const share = high > low ? (value - low) / (high - low) : 0;
  return Math.min(STEPS - 1, Math.max(0, Math.floor(share * STEPS)));
}

/** Black or white, whichever has more contrast on a colour. */
export function inkOn(colour) {
  const [r, g, b] = channels(colour);
  return 0.299 * r + 0.587 * g + 0.114 * b > 140 ? "#14181a" : "#ffffff";
}

function between(share) {
  const place = share * (STOPS.length - 1);
  const first = Math.min(Math.floor(place), STOPS.length - 2);
  const [from, to] = [channels(STOPS[first]), channels(STOPS[first + 1])];
  const mixed = from.map((value, n) => Math.round(value + (to[n] - value) * (place - first)));
  return `#${mixed.map((value) => value.toString(16).padStart(2, "0")).join("")}`;
}

function channels(colour) {
  return [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
}
