/** What the page of the landmarks asks the server. */

import { file, get, post } from "../shared/api.js";

/**
 * Addresses of one map.
 * @param {string} slug
 */
export function landmarksOf(slug) {
  const path = `/maps/${encodeURIComponent(slug)}/landmarks`;
  return {
    show: () => get(path),
    build: () => post(path, {}),
    job: (id) => get(`/jobs/${id}`),
    block: async (key, number) => (await file(`${path}/points/${key}/${number}`)).arrayBuffer(),
  };
}
