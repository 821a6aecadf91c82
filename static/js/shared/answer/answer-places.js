/**
 * Positions of the hypotheses in a placement. In the exact one, they are as computed. In any other, a hypothesis is
 * at the position of the photo that supports it best; hypotheses at the same position are merged and their
 * probabilities added up: so a map of clusters answers "which part is it?".
 */

import { BASE_FLOOR } from "../map/map-store.js";

/**
 * @param {?Object} answer
 * @param {import("../map/map-store.js").MapStore} store
 * @returns {Array<{position: [number, number], probability: number, ranks: number[], radius: ?number,
 *   heading: ?number, experiences: number[], floor: number}>} the most probable last, so that it is drawn on top
 */
export function placesOf(answer, store) {
  if (!answer) return [];
  const spots = new Map();
  for (const hypothesis of answer.hypotheses) {
    const exact = store.placement === null;
    const position = exact ? [hypothesis.x_px, hypothesis.y_px] : elsewhere(hypothesis, store);
    if (!position) continue;
    const floor = hypothesis.floor ?? BASE_FLOOR;
    const key = exact ? hypothesis.rank : [...position, floor].join(";");
    const there = spots.get(key);
    if (there) {
      there.probability += hypothesis.probability;
      there.ranks.push(hypothesis.rank);
      there.experiences.push(...hypothesis.experiences);
    } else {
      spots.set(key, {
        position,
        probability: hypothesis.probability,
        ranks: [hypothesis.rank],
        radius: exact ? reach(hypothesis, answer) : null,
        heading: hypothesis.heading_deg,
        experiences: [...hypothesis.experiences],
        floor,
      });
    }
  }
  return [...spots.values()].sort((a, b) => a.probability - b.probability);
}

/** Radius to draw; an area has none of its own and is drawn with the place radius. */
function reach({ kind, radius_px }, { place_radius_px }) {
  return kind === "area" ? place_radius_px ?? null : radius_px;
}

function elsewhere({ experiences }, store) {
  return experiences.map((id) => store.position(id)).find((position) => position) || null;
}
