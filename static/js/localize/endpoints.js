/** Requests of the localization page to the server, by name. */

import { del, file, get, post, upload } from "../shared/api.js";

/**
 * The requests about one map.
 * @param {string} slug
 */
export function endpointsOf(slug) {
  const map = `/maps/${encodeURIComponent(slug)}`;
  return {
    photosAfter: (id, most) => get(`${map}/photos?after=${id}&limit=${most}`),
    changes: (since) => get(`${map}/changes?since=${since}`),
    ask: (files, options, on = {}) => upload(`${map}/localize`, { body: form(files, options), ...on }),
    askAgain: (query, options, on) => upload(`${map}/localize`, { body: form([], { ...options, query }), ...on }),
    example: (name) => file(`${map}/examples/${encodeURIComponent(name)}`),
    photo: (id) => file(`${map}/queries/${id}/photo`),
    query: (id) => get(`${map}/queries/${id}`),
    matches: (id, signal) => get(`${map}/queries/${id}/matches`, { signal }),
    history: (before) => get(`${map}/queries?limit=30${before ? `&before=${before}` : ""}`),
    forget: (id) => del(`${map}/queries/${id}`),
    adopt: (id, place) => post(`${map}/queries/${id}/adopt`, place),
    coordinates: ([x, y], signal) => get(`${map}/coordinates?x_px=${x}&y_px=${y}`, { signal }),
  };
}

function form(files, options) {
  const made = new FormData();
  for (const photo of files) made.append("file", photo, photo.name || "photo.jpg");
  for (const [name, value] of Object.entries(options)) {
    if (value !== null && value !== undefined && value !== "") made.append(name, value);
  }
  return made;
}
