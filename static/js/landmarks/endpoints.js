/** Requests of the landmarks page to the server. */

import { del, file, get, post, put } from "../shared/api.js";

/**
 * The requests about one map.
 * @param {string} slug
 */
export function landmarksOf(slug) {
  const path = `/maps/${encodeURIComponent(slug)}/landmarks`;
  return {
    ...cloudAt(path),
    build: () => post(path, {}),
    points: () => get(`${path}/control-points`),
    keepPoint: (name, point) => put(`${path}/control-points/${encodeURIComponent(name)}`, point),
    removePoint: (name) => del(`${path}/control-points/${encodeURIComponent(name)}`),
    undo: () => post(`/maps/${encodeURIComponent(slug)}/undo`, {}),
    job: (id) => get(`/jobs/${id}`),
  };
}

/**
 * The requests about one share.
 * @param {string} token
 */
export function sharedLandmarks(token) {
  return cloudAt(`/shared/${encodeURIComponent(token)}/landmarks`);
}

function cloudAt(path) {
  return {
    show: () => get(path),
    block: async (key, number) => (await file(`${path}/points/${key}/${number}`)).arrayBuffer(),
  };
}
