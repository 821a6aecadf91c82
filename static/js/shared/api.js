/**
 * The only module that talks to the server.
 */

import { metaOf } from "./dom.js";
import { t } from "./i18n.js";

const BASE = "/api/v1";
const WAIT_MS = [300, 1000, 2000, 4000, 8000];
const MOST_WAIT_S = 5;
const EVENTS = "text/event-stream";
const SAFE = new Set(["GET", "HEAD"]);

/** A request that the server refused, or that did not reach it (`code` is `offline`, `status` 0). */
export class ApiError extends Error {
  /** @param {{status: number, code: string, message: string, hint?: ?string, where?: ?string, next?: ?number}} fields */
  constructor({ status, code, message, hint = null, where = null, next = null }) {
    super(message);
    this.name = "ApiError";
    this.status = status;
    this.code = code;
    this.hint = hint;
    this.where = where;
    this.next = next; // number of the record with which a sender has to continue
  }
}

/**
 * Send a request to the API.
 * @param {string} path below /api/v1, as `/maps`
 * @param {Object} [options]
 * @param {string} [options.method]
 * @param {*} [options.json] sent as JSON
 * @param {BodyInit} [options.body] sent unchanged: a FormData, a Blob
 * @param {Object<string, string>} [options.headers]
 * @param {AbortSignal} [options.signal]
 * @param {boolean} [options.patient] whether to retry on network failures or a busy server; by default GET and HEAD
 * @returns {Promise<*>} the answer's JSON; null for an empty one
 * @throws {ApiError}
 */
export async function api(path, { method = "GET", json, body, headers = {}, signal, patient = SAFE.has(method) } = {}) {
  const sent = { Accept: "application/json", ...headers };
  if (json !== undefined) {
    sent["Content-Type"] = "application/json";
    body = JSON.stringify(json);
  }
  if (!SAFE.has(method)) sent["X-CSRFToken"] = csrfToken();
  const options = { method, headers: sent, body, signal, credentials: "same-origin" };
  return read(await (patient ? withRetries(path, options) : once(path, options)));
}

/** @see api */
export const get = (path, options = {}) => api(path, options);
/** @see api */
export const post = (path, json, options = {}) => api(path, { ...options, method: "POST", json });
/** @see api */
export const put = (path, json, options = {}) => api(path, { ...options, method: "PUT", json });
/** @see api */
export const patch = (path, json, options = {}) => api(path, { ...options, method: "PATCH", json });
/** @see api */
export const del = (path, options = {}) => api(path, { ...options, method: "DELETE" });

/**
 * Fetch a file.
 * @param {string} path
 * @returns {Promise<Blob>}
 * @throws {ApiError}
 */
export async function file(path) {
  const response = await withRetries(path, { credentials: "same-origin" });
  return response.ok ? response.blob() : read(response);
}

/**
 * Fetch a page of this site; if the session has ended, reload, which leads to the sign-in page.
 * @param {string} address
 * @returns {Promise<Document>}
 * @throws {ApiError}
 */
export async function page(address) {
  const response = await withRetries(address, { credentials: "same-origin" }, "");
  if (response.redirected) location.reload();
  if (!response.ok) await read(response);
  return new DOMParser().parseFromString(await response.text(), "text/html");
}

/**
 * Send a file with progress, which fetch cannot report.
 * @param {string} path
 * @param {Object} options
 * @param {string} [options.method]
 * @param {FormData|Blob} options.body
 * @param {Object<string, string>} [options.headers]
 * @param {function(number, number): void} [options.onProgress] bytes sent, bytes in all
 * @param {function(string, Object): void} [options.onEvent] called with the kind and data of each server-sent event
 *   before the answer; the server may send none
 * @param {AbortSignal} [options.signal]
 * @returns {Promise<*>}
 * @throws {ApiError}
 */
export function upload(path, { method = "POST", body, headers = {}, onProgress, onEvent, signal }) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open(method, BASE + path);
    const accept = onEvent ? `${EVENTS}, application/json;q=0.5` : "application/json";
    const all = { Accept: accept, "X-CSRFToken": csrfToken(), ...headers };
    for (const [name, value] of Object.entries(all)) request.setRequestHeader(name, value);
    request.upload.onprogress = (event) => event.lengthComputable && onProgress?.(event.loaded, event.total);
    const last = onEvent && eventReader(request, onEvent);
    request.onload = () => resultOf(request, last).then(resolve, reject);
    request.onerror = () => reject(offline());
    request.onabort = () => reject(new DOMException("Aborted", "AbortError"));
    signal?.addEventListener("abort", () => request.abort(), { once: true });
    request.send(body);
  });
}

/**
 * Listen to server-sent events; the browser reconnects when the stream ends.
 * @param {string} path
 * @param {Object} listeners
 * @param {function(Object, string): void} listeners.changed called with the data of each event, and its id
 * @param {function(): void} listeners.open
 * @param {function(boolean): void} listeners.error called with whether the browser has given up
 * @returns {{close: function(): void}}
 */
export function events(path, { changed, open, error }) {
  const source = new EventSource(BASE + path);
  source.addEventListener("changed", ({ data, lastEventId }) => changed(JSON.parse(data), lastEventId));
  source.addEventListener("open", open);
  source.addEventListener("error", () => error(source.readyState === EventSource.CLOSED));
  return source;
}

/**
 * Read the events of a response while it arrives.
 * @param {XMLHttpRequest} request
 * @param {function(string, Object): void} onEvent
 * @returns {function(): ?{kind: string, data: Object}} the last event, `answer` or `error`; null: there is none yet
 */
function eventReader(request, onEvent) {
  let at = 0;
  let last = null;
  const take = () => {
    if (!isEvents(request)) return;
    for (let end; (end = request.responseText.indexOf("\n\n", at)) >= 0; at = end + 2) {
      const [kind, data] = request.responseText.slice(at, end).split("\n").map((line) => line.slice(line.indexOf(":") + 2));
      const event = { kind, data: JSON.parse(data) };
      if (kind === "answer" || kind === "error") last = event;
      else onEvent(kind, event.data);
    }
  };
  request.onprogress = take;
  return () => {
    take();
    return last;
  };
}

function isEvents(request) {
  return (request.getResponseHeader("Content-Type") || "").startsWith(EVENTS);
}

/** The answer of a request, which may be the last of its events. */
async function resultOf(request, last) {
  if (!isEvents(request)) return read(new Response(request.response || null, answerOf(request)));
  const event = last();
  if (!event) throw offline(); // the stream was cut off
  if (event.kind === "error") throw new ApiError({ status: event.data.status, ...event.data.error });
  return event.data;
}

function csrfToken() {
  return metaOf("csrf-token")?.content ?? ""; // pages for visitors have none
}

function answerOf(request) {
  const type = request.getResponseHeader("Content-Type") || "";
  return { status: request.status, headers: { "Content-Type": type } };
}

async function once(path, options, base = BASE) {
  try {
    const response = await fetch(base + path, options);
    announce("online");
    return response;
  } catch (error) {
    if (error.name === "AbortError") throw error;
    announce("offline");
    throw offline();
  }
}

/** Retry when the network fails, or when a busy server asks for it; for requests that change nothing. */
async function withRetries(path, options, base = BASE) {
  for (let wait of WAIT_MS) {
    try {
      const response = await once(path, options, base);
      const asked = busyMs(response);
      if (asked === null) return response;
      wait = Math.max(wait, asked);
    } catch (error) {
      if (error.code !== "offline") throw error;
    }
    await new Promise((resolve) => setTimeout(resolve, wait));
    options.signal?.throwIfAborted();
  }
  return once(path, options, base);
}

/** Milliseconds that a busy server asks to wait, if that is short; else null. @param {Response} response */
function busyMs(response) {
  const seconds = Number(response.headers.get("Retry-After") || NaN);
  return response.status === 503 && seconds <= MOST_WAIT_S ? seconds * 1000 : null;
}

async function read(response) {
  const isJson = (response.headers.get("Content-Type") || "").includes("json");
  if (response.ok) {
    const answer = isJson && response.status !== 204 ? await response.json() : null;
    if (answer?.job) window.dispatchEvent(new Event("expmap:job")); // a job was started; the header shows it
    return answer;
  }
  const failure = isJson ? (await response.json()).error : null;
  const error = new ApiError({ status: response.status, ...(failure || unreadable(response)) });
  if (error.status === 401) location.assign(`/sign-in?next=${encodeURIComponent(location.pathname)}`);
  throw error;
}

function unreadable(response) {
  return { code: "unreadable", message: t("The response of the server cannot be read ({status}).", { status: response.status }) };
}

function offline() {
  const message = t("The server cannot be reached.");
  return new ApiError({ status: 0, code: "offline", message, hint: t("Check the network; nothing you did is lost.") });
}

let lastState = "";

/** Fire `expmap:offline` or `expmap:online` on `window` when the state changes. */
function announce(state) {
  if (lastState === state) return;
  lastState = state;
  window.dispatchEvent(new Event(`expmap:${state}`));
}
