/** Uncertainty of visual fixes, and fixes rejected by the fusion: circles and crosses on the map. */

import { debounce } from "../shared/timing.js";
import { toastError } from "../shared/toast.js";

const MOST = 2000;
const CALM_MS = 1500;
/** Radius of the circle, and scale of the ellipse, with 68 % of a two-dimensional normal distribution, in standard deviations. */
export const WITHIN_68 = 1.51;

/** Keep the fixes of the page's mission up to date. @param {import("./mission-store.js").MissionStore} store */
export function showFixes(store) {
  const server = store.server(store.id);
  let seen = "";
  const state = () => JSON.stringify(store.mission.tracks.filter(({ source }) => source === "visual" || source === "fused").map(({ id, poses }) => [id, poses]));
  const load = async () => {
    seen = state();
    try {
      const fused = store.mission.tracks.some(({ source }) => source === "fused");
      const [fixes, gated] = await Promise.all([radii(server), fused ? leftOut(server) : []]);
      store.setFixes([...fixes, ...gated]);
    } catch (error) {
      toastError(error);
    }
  };
  const later = debounce(load, CALM_MS);
  store.on("missions grown", () => state() !== seen && later());
  if (state() !== "[]") load();
}

async function radii(server) {
  const wish = { from: "poses", select: "time, lat, lon, var_e, var_n", where: "source = 'visual' AND var_e IS NOT NULL", limit: MOST };
  const { rows } = await server.query(wish);
  return rows.map(([time, lat, lon, east, north]) => ({ time, lat, lon, radius_m: radiusOf(east, north), gated: false }));
}

/** Fixes of all sources that the fusion rejected as outliers. */
async function leftOut(server) {
  try {
    const { gated } = await server.fusion();
    return gated.map(({ time_s: time, lat, lon }) => ({ time, lat, lon, radius_m: null, gated: true }));
  } catch (error) {
    if (error.status === 404) return []; // the fused track was not computed here
    throw error;
  }
}

/** @returns {number} metres, from the variances to the east and to the north */
export function radiusOf(east, north) {
  return WITHIN_68 * Math.sqrt((east + north) / 2);
}
