/** The editor's requests to the server, by name. */

import { api, del, get, patch, post, put, upload } from "../shared/api.js";
import { uploadEndpoints } from "../shared/uploads.js";

/**
 * The requests about one map.
 * @param {string} slug
 */
export function endpointsOf(slug) {
  const map = `/maps/${encodeURIComponent(slug)}`;
  const form = (fields) => {
    const made = new FormData();
    for (const [name, value] of Object.entries(fields)) if (value !== null && value !== undefined) made.append(name, value);
    return made;
  };
  return {
    photosAfter: (id, most) => get(`${map}/photos?after=${id}&limit=${most}`),
    changes: (since) => get(`${map}/changes?since=${since}`, { patient: false }),
    edit: (edits) => patch(`${map}/experiences`, edits),
    addNote: ({ id: _id, ...note }) => post(`${map}/notes`, note),
    changeNote: ({ id, ...note }, seen) => put(`${map}/notes/${id}`, note, { headers: ifMatch(seen) }),
    removeNote: (id, seen) => del(`${map}/notes/${id}`, { headers: ifMatch(seen) }),
    addFloor: (floor) => api(`${map}/floors`, { method: "POST", body: form(floor) }),
    changeFloor: (id, fields) => patch(`${map}/floors/${id}`, fields),
    setFloorImage: (id, file) => api(`${map}/floors/${id}/image`, { method: "PUT", body: form({ file }) }),
    alignFloor: (id, pairs) => post(`${map}/floors/${id}/align`, { pairs }),
    removeFloor: (id) => del(`${map}/floors/${id}?tray=1`),
    remove: (photos) => del(`${map}/experiences`, { json: photos }),
    undo: () => post(`${map}/undo`, {}),
    redo: () => post(`${map}/redo`, {}),

    setSatellite: (file, { onProgress = undefined, tray = false } = {}) =>
      upload(`${map}/satellite`, { method: "PUT", body: form({ file, tray }), onProgress }),

    ...uploadEndpoints(slug),

    placeByGps: () => post(`${map}/photos/place-by-gps`, {}),
    placeByList: (fields, { preview }) =>
      api(`${map}/positions?preview=${preview}`, { method: "POST", body: form(fields) }),
    matchTrack: (fields, { preview }) =>
      api(`${map}/gpx?preview=${preview}`, { method: "POST", body: form(fields) }),

    rest: () => get(`${map}/place-rest`),
    findRest: () => post(`${map}/place-rest`, {}),
    correctRest: (ids) => post(`${map}/place-rest/correct`, { ids }),
    acceptRest: (ids) => post(`${map}/place-rest/accept`, { ids }),

    pieces: () => get(`${map}/pieces`),
    checkPieces: () => post(`${map}/pieces`, {}),
    plan: () => get(`${map}/photo-plan`),
    makePlan: (wish) => post(`${map}/photo-plan`, wish),

    streetServices: () => get(`${map}/street-photos`),
    countStreet: (wish) => post(`${map}/street-photos/preview`, wish),
    addStreet: (wish) => post(`${map}/street-photos`, wish),

    videos: () => get(`${map}/videos`),
    cutVideo: (wish) => post(`${map}/videos`, wish),

    readMask: (file) => api(`${map}/photos/mask`, { method: "POST", body: form({ file }) }),
    suggestBlur: (id) => get(`${map}/photos/${id}/blur/suggestions`),
    blurFound: () => get(`${map}/blur/suggestions?boxes=0`),
    searchBlur: () => post(`${map}/blur/suggestions`, {}),
    blur: (id, boxes, seen) => put(`${map}/photos/${id}/blur`, { boxes, seen }),

    findings: () => get(`${map}/findings`),
    fix: (code, ids) => post(`${map}/findings/fix`, { code, ids }),
    health: () => get(`${map}/health`),
    findHealth: () => post(`${map}/health`, {}),
    putPlacement: (name, wish) => put(`${map}/placements/${encodeURIComponent(name)}`, wish),
    deletePlacement: (name) => del(`${map}/placements/${encodeURIComponent(name)}`),
    cfgOf: (placement) => `/api/v1${map}/${placement === null ? "map" : `placements/${encodeURIComponent(placement)}`}.cfg`,

    cancelJob: (id) => post(`/jobs/${id}/cancel`, {}),
    retryJob: (id) => post(`/jobs/${id}/retry`, {}),
  };
}

/** Header with which the server refuses the request after newer changes. @param {number} revision */
function ifMatch(revision) {
  return { "If-Match": String(revision) };
}
