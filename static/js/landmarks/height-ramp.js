/** Colours of heights: lighter with height, safe for colour blindness. */

const STOPS = ["#5a4fcf", "#2f86d8", "#1fb5a0", "#8cd24f", "#fde74c"];

/** CSS gradient for a legend. */
export const rampGradient = `linear-gradient(90deg, ${STOPS.join(", ")})`;

/** Red, green, blue of each stop, 0 to 1. @returns {number[][]} */
export function rampColours() {
  return STOPS.map((stop) => [1, 3, 5].map((start) => parseInt(stop.slice(start, start + 2), 16) / 255));
}
