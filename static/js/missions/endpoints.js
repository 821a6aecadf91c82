/** Requests of the missions pages to the server. */

import { del, events, get, patch, post, upload } from "../shared/api.js";

/**
 * The list of missions, or those in the bin.
 * @param {{binned?: boolean, search?: string, after?: ?string, limit?: ?number, previews?: boolean}} [wish] `after`: `next` of the previous page; without a limit, all
 */
export const missionList = ({ binned = false, search = "", after = null, limit = null, previews = false } = {}) => get(`/missions?${parameters({ bin: binned, search, after, limit, previews })}`);
/** @param {{name: string, map: ?string, start: ?Object, note: string}} wish */
export const makeMission = (wish) => post("/missions", wish);

/** Requests about an uploaded file with tracks before its import. */
export const fileEndpoints = {
  begin: (about) => post("/mission-files", about),
  look: (id) => get(`/mission-files/${id}`),
  sendChunk: (id, chunk, options) => upload(`/mission-files/${id}`, { method: "PATCH", body: chunk, ...options }),
  contents: (id, reading) => post(`/mission-files/${id}/contents`, reading),
  importFile: (id, wish) => post(`/mission-files/${id}/import`, wish),
  drop: (id) => del(`/mission-files/${id}`),
  job: (job) => get(`/jobs/${job}`),
  cancel: (job) => post(`/jobs/${job}/cancel`, {}),
};

/** The image of a map, with its georeference; null without one. @param {string} slug @returns {Promise<?Object>} */
export async function mapImage(slug) {
  const { satellite, georeference } = await get(`/maps/${encodeURIComponent(slug)}`);
  return satellite && { ...satellite, georeference };
}

/**
 * The requests about one mission.
 * @param {number} id
 */
export function endpointsOf(id) {
  const base = `/missions/${id}`;
  return {
    state: () => get(base),
    change: (fields) => patch(base, fields),
    bin: () => del(base),
    restore: () => post(`${base}/restore`, {}),
    deleteForever: () => del(`${base}?forever=true`),
    line: (track, wish, signal) => get(`${base}/tracks/${track}/line?${parameters(wish)}`, { signal }),
    profile: (track, points, signal) => get(`${base}/tracks/${track}/profile?points=${points}`, { signal }),
    /** @param {number} track @param {Object} look fields of it, for all who look at the mission */
    setLook: (track, look) => patch(`${base}/tracks/${track}`, look),
    objects: (wish, signal) => get(`${base}/objects?${parameters(wish)}`, { signal }),
    object: (object) => get(`${base}/objects/${encodeURIComponent(object)}`),
    setState: (object, change) => patch(`${base}/objects/${encodeURIComponent(object)}`, change),
    drawings: () => get(`${base}/drawings`),
    coverage: () => get(`${base}/coverage`),
    addDrawing: (fields) => post(`${base}/drawings`, fields),
    changeDrawing: (drawing, fields) => patch(`${base}/drawings/${drawing}`, fields),
    /** @param {number} drawing id @param {number} revision that was seen */
    deleteDrawing: (drawing, revision) => del(`${base}/drawings/${drawing}?revision=${revision}`),
    robots: () => get(`${base}/robots`),
    photos: () => get(`${base}/photos`),
    events: (cursor, listeners) => events(`${base}/events?${parameters({ cursor })}`, listeners),
    query: (wish) => get(`${base}/query?${parameters(wish)}`),
    removeFusion: () => del(`${base}/fusion`),
    fusion: () => get(`${base}/fusion`),
    localize: (sha256) => post(`${base}/photos/${sha256}/fix`, {}),
    /** @param {?number} odometry id of the track to correct; null unless there are several */
    fuse: (odometry) => post(`${base}/fuse`, { odometry }),
    job: (job) => get(`/jobs/${job}`),
    shares: () => get(`${base}/shares`),
    share: (wish) => post(`${base}/shares`, wish),
    revoke: (share) => del(`${base}/shares/${share}`),
    phones: () => get(`${base}/phones`),
    addPhone: (name) => post(`${base}/phones`, { name }),
    removePhone: (phone) => del(`${base}/phones/${phone}`),
    /** Address of a file that the browser downloads. */
    file: (name) => `/api/v1${base}/${name}`,
    photo: (sha256) => `/api/v1${base}/photos/${sha256}/preview`,
  };
}

function parameters(wish) {
  const known = Object.entries(wish).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return new URLSearchParams(known).toString();
}
