/**
 * The service worker: pages open without a network. The server puts `const SHELL = {version, files}` before this.
 *
 * Pages and the state of maps come from the network, and from what was kept where it fails. The files that pages are
 * made of are kept as one version, all of them or none. Pictures never change under their address, so they are kept.
 * What changes something is never touched here: photos that were taken offline wait in the page's own outbox.
 */

const FILES = `files-${SHELL.version}`;
const PAGES = `pages-${SHELL.version}`;
const STATE = "state";
const WHO = "who";
const FIELD = "/field";
const AWAY = "/offline";

const MAP = "/api/v1/maps/[^/]+";
const KEPT_PAGES = /^\/($|field$|offline$|missions$|maps\/[^/]+\/(edit|localize)$)/;
const KEPT_STATE = new RegExp(`^/api/v1/maps$|^${MAP}(/photos|/photo-plan)?$`);
const PICTURES = [
  { cache: "ground", most: 2000, path: new RegExp(`^${MAP}/(satellite|satellite/tiles/.+|thumbnail|floors/\\d+/image)$`), versioned: true },
  { cache: "thumbs", most: 3000, path: new RegExp(`^${MAP}/(photos|queries)/\\d+/thumb$`) },
  { cache: "previews", most: 200, path: new RegExp(`^${MAP}/(photos|queries)/\\d+/preview$`) },
];
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

/** Keep the page that was opened before there was a service worker, and those that stand in for others. */
async function keepPage(last) {
  const cache = await caches.open(PAGES);
  for (const path of new Set([FIELD, AWAY, last])) {
    if (!KEPT_PAGES.test(path) || (await cache.match(path))) continue;
    const response = await fetch(path);
    if (isKept(response)) await cache.put(path, response);
  }
}

/** A page was opened by an account; none of it is kept where nobody is signed in. */
async function opened({ account, page: path }) {
  await belongTo(account);
  if (account) await keepPage(path);
}

/** What one account has seen is not for the next one. */
async function belongTo(account) {
  const cache = await caches.open(WHO);
  const before = await cache.match("/account");
  if (before && (await before.text()) === account) return;
  if (before) await Promise.all(PRIVATE.map((name) => caches.delete(name)));
  await cache.put("/account", new Response(account));
}

/** A page: as the server has it now, or where it does not answer in time, as it was last. */
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

/** A page that is not kept. */
async function otherPage({ request }) {
  return fetch(request).catch(away);
}

/** What is shown instead of a page that is not kept. */
async function away(error) {
  const found = await (await caches.open(PAGES)).match(AWAY);
  if (!found) throw error;
  return found;
}

/** A file of a page: its address has its version, so that what is kept is never an old one. */
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

/** Keep an answer, and not too many of its kind; a full disk only means that less is there without a network. */
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
