/**
 * The service worker, for pages without a network. The server puts `const SHELL = {version, files}` before this.
 *
 * Pages and the state of maps come from the network, or from the cache if it fails. Scripts and styles are cached as
 * one version, all of them or none. Pictures never change under their address, so they are cached. Requests that
 * change something are not handled here: photos taken offline wait in the outbox of the page.
 */

const FILES = `files-${SHELL.version}`;
const PAGES = `pages-${SHELL.version}`;
const STATE = "state";
const WHO = "who";
const FIELD = "/field";
const AWAY = "/offline";

const MAP = "/api/v1/maps/[^/]+";
const KEPT_PAGES = /^\/($|field$|offline$|missions$|maps\/[^/]+\/(view|edit|localize)$)/;
const KEPT_STATE = new RegExp(`^/api/v1/maps$|^${MAP}(/photos|/photo-plan)?$`);
const PICTURES = [
  { cache: "ground", most: 2000, path: new RegExp(`^${MAP}/(satellite|satellite/tiles/.+|thumbnail|floors/\\d+/image)$`), versioned: true },
  { cache: "thumbs", most: 3000, path: new RegExp(`^${MAP}/(photos|queries)/\\d+/thumb$`) },
  { cache: "previews", most: 200, path: new RegExp(`^${MAP}/(photos|queries)/\\d+/preview$`) },
];
const SIGNS_IN_OR_OUT = /^\/sign-(in(\/.*)?|out)$/;
const PRIVATE = [PAGES, STATE, ...PICTURES.map(({ cache }) => cache)];
const MOST_PAGES = 40;
const PATIENCE_MS = 8000;
const TRIM_EVERY = 25;

let kept = 0;

self.addEventListener("install", (event) => event.waitUntil(install()));
self.addEventListener("activate", (event) => event.waitUntil(activate()));
self.addEventListener("message", (event) => event.waitUntil(opened(event.data)));
self.addEventListener("fetch", (event) => {
  const url = new URL(event.request.url);
  // at once: without a network, the next page may be one of the account before
  if (event.request.method === "POST" && SIGNS_IN_OR_OUT.test(url.pathname)) event.waitUntil(belongTo(""));
  const answer = event.request.method === "GET" && url.origin === location.origin && answerOf(event.request, url);
  if (answer) event.respondWith(answer(event, url));
});

function answerOf(request, url) {
  if (request.mode === "navigate") {
    if (KEPT_PAGES.test(url.pathname)) return page;
    return url.pathname.startsWith("/api/") ? null : otherPage;
  }
  if (url.pathname.startsWith("/static/")) return file;
  if (KEPT_STATE.test(url.pathname)) return state;
  const found = PICTURES.find(({ path, versioned }) => path.test(url.pathname) && (!versioned || url.searchParams.has("v")));
  return found ? (event) => picture(event, found) : null;
}

async function install() {
  const files = await caches.open(FILES);
  await files.addAll(SHELL.files);
  await self.skipWaiting();
}

async function activate() {
  const wanted = new Set([FILES, WHO, ...PRIVATE]);
  const names = await caches.keys();
  await Promise.all(names.filter((name) => !wanted.has(name)).map((name) => caches.delete(name)));
  await self.clients.claim();
}

/** Cache the page that was opened before the service worker ran, and the pages used as fallbacks. */
async function keepPage(last) {
  const cache = await caches.open(PAGES);
  for (const path of new Set([FIELD, AWAY, last])) {
    if (!KEPT_PAGES.test(path) || (await cache.match(path))) continue;
    const response = await fetch(path);
    if (isKept(response)) await cache.put(path, response);
  }
}

/** Drop caches of another account, and cache the page if an account has opened it. */
async function opened({ account, page: path }) {
  await belongTo(account);
  if (account) await keepPage(path);
}

/** Delete private caches when the account changes. */
async function belongTo(account) {
  const cache = await caches.open(WHO);
  const before = await cache.match("/account");
  if (before && (await before.text()) === account) return;
  if (before) await Promise.all(PRIVATE.map((name) => caches.delete(name)));
  await cache.put("/account", new Response(account));
}

/** A page from the server, or from the cache if it does not answer in time. */
async function page(event, url) {
  const cache = await caches.open(PAGES);
  const last = await cache.match(url.pathname);
  const fresh = fetch(event.request).then((response) => {
    if (isKept(response)) keep(event, cache, { key: url.pathname, response, most: MOST_PAGES });
    return response;
  });
  try {
    return await (last ? Promise.race([fresh, late()]) : fresh);
  } catch (error) {
    if (last) return last;
    if (!url.pathname.startsWith("/maps/") || !(await cache.match(FIELD))) return away(error);
    return Response.redirect(`${FIELD}?map=${encodeURIComponent(url.pathname.split("/")[2] || "")}`);
  }
}

/** A page that is not cached. */
async function otherPage({ request }) {
  return fetch(request).catch(away);
}

/** Fallback for a page that is not cached. */
async function away(error) {
  const found = await (await caches.open(PAGES)).match(AWAY);
  if (!found) throw error;
  return found;
}

/** A file of a page; its address contains the version, so a cached one is never outdated. */
async function file({ request }) {
  return (await (await caches.open(FILES)).match(request)) || fetch(request);
}

async function state(event) {
  const { request } = event;
  const cache = await caches.open(STATE);
  try {
    const response = await fetch(request);
    if (isKept(response)) keep(event, cache, { key: request, response, most: MOST_PAGES });
    else if (response.status === 404) await cache.delete(request);
    return response;
  } catch (error) {
    const last = await cache.match(request);
    if (last) return last;
    throw error;
  }
}

async function picture(event, { cache: name, most }) {
  const { request } = event;
  const cache = await caches.open(name);
  const found = await cache.match(request);
  if (found) return found;
  const response = await fetch(request);
  if (isKept(response)) keep(event, cache, { key: request, response, most });
  return response;
}

function isKept(response) {
  return response.ok && response.status === 200 && !response.redirected && response.type === "basic";
}

/** Cache a response and limit the number; if the disk is full, less is available offline. */
function keep(event, cache, { key, response, most }) {
  kept += 1;
  const trim = kept % TRIM_EVERY === 0;
  const done = cache.put(key, response.clone()).then(() => trim && forgetOldest(cache, most));
  event.waitUntil(done.catch((error) => console.info(`not kept: ${error.message}`)));
}

async function forgetOldest(cache, most) {
  const keys = await cache.keys();
  await Promise.all(keys.slice(0, Math.max(keys.length - most, 0)).map((key) => cache.delete(key)));
}

function late() {
  return new Promise((_, reject) => setTimeout(() => reject(new Error("the server does not answer")), PATIENCE_MS));
}
