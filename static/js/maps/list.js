/** Actions on whole maps: in the list, in the bin, and on the settings page. */

import { queryAll } from "../shared/dom.js";
import { del, page, patch, post, upload } from "../shared/api.js";
import { askDialog, busy, confirmDialog } from "../shared/dialogs.js";
import { t, tn } from "../shared/i18n.js";
import { byName, largest, ListTools } from "../shared/list-tools.js";
import { toastError } from "../shared/toast.js";
import { findPhoto } from "./find-photo.js";

const cards = document.getElementById("maps");
const more = document.getElementById("more"); // link to the next part of the list, if any
let searched = new URLSearchParams(location.search).get("search") ?? ""; // by the server
let asked = 0; // number of requests, to discard responses to outdated ones
const tools = document.getElementById("list-tools") && new ListTools(cards, {
  kept: "expmap.maps-sort",
  orders: { name: byName, photos: largest("photos") },
  bin: (slug) => del(`/maps/${slug}`),
  restore: (slug) => post(`/maps/${slug}/restore`, {}),
  binned: (n) => tn("{n} map is in the bin.", "{n} maps are in the bin.", n),
  search: (text) => show({ search: text }),
  whole: () => show({ whole: "true" }),
});
const search = document.getElementById("list-search");
if (search instanceof HTMLInputElement) search.value = searched;
const actions = { rename, duplicate, delete: bin, restore, "delete-forever": deleteForever };

if (cards) goOn(queryAll(":scope > li", HTMLElement, cards));
else connect(document.body);
more?.addEventListener("click", (event) => {
  event.preventDefault();
  busy(more, showMore).catch(toastError);
});
const finder = document.getElementById("find");
if (finder instanceof HTMLButtonElement) {
  finder.addEventListener("click", findPhoto);
  finder.disabled = false;
}
connectImport(document.getElementById("import"), document.getElementById("import-file"));

/** Connect the buttons in an element. @param {HTMLElement} place */
function connect(place) {
  for (const button of queryAll("[data-action]", HTMLButtonElement, place)) {
    button.addEventListener("click", () => {
      const { slug, name } = /** @type {HTMLElement} */ (button.closest("[data-slug]")).dataset;
      button.closest("details")?.removeAttribute("open");
      actions[button.dataset.action](slug, name).catch(toastError);
    });
    button.disabled = false; // disabled until this listener is attached
  }
}

/** Connect new cards. @param {HTMLElement[]} come */
function goOn(come) {
  for (const card of come) connect(card);
  tools?.refresh({ whole: more.hidden, searched });
}

/** Show another part of the list instead of this one. @param {Object<string, string>} part */
async function show(part) {
  const come = await fetchCards(`/?${new URLSearchParams(part)}`);
  if (!come) return;
  searched = part.search ?? "";
  cards.replaceChildren(...come);
  goOn(come);
}

async function showMore() {
  const come = await fetchCards(more.getAttribute("href"));
  if (!come) return;
  cards.append(...come);
  goOn(come);
  queryAll("a, button", HTMLElement, come[0])[0]?.focus();
}

/** Fetch a part of the list; null if a newer request was made meanwhile. @param {string} address */
async function fetchCards(address) {
  asked += 1;
  const question = asked;
  const answer = await page(address);
  if (question !== asked) return null;
  const next = answer.getElementById("more");
  more.hidden = !next?.hasAttribute("href");
  more.setAttribute("href", next?.getAttribute("href") ?? "");
  return queryAll("#maps > li", HTMLElement, answer.documentElement);
}

async function rename(slug, name) {
  askDialog({ title: t("Rename the map"), label: t("Name"), value: name, action: t("Rename") }, async (wanted) => {
    await patch(`/maps/${slug}`, { name: wanted });
    location.reload();
  });
}

async function duplicate(slug) {
  goTo(await post(`/maps/${slug}/duplicate`, {}));
}

/** Move a map to the bin; in the list this can be undone, on its settings page it is confirmed first. */
async function bin(slug, name) {
  if (tools) return tools.toBin(tools.cards.filter(({ dataset }) => dataset.slug === slug));
  const title = t("Move {name} to the bin?", { name });
  const text = t("It can be restored from there.");
  if (!(await confirmDialog({ title, text, action: t("Move to the bin") }))) return;
  await del(`/maps/${slug}`);
  return location.assign("/");
}

async function restore(slug) {
  await post(`/maps/${slug}/restore`, {});
  location.reload();
}

async function deleteForever(slug, name) {
  const title = t("Delete {name} permanently?", { name });
  const text = t("Its photos, its image and all its edits are deleted from the disk. This cannot be undone.");
  if (!(await confirmDialog({ title, text, action: t("Delete permanently"), danger: true }))) return;
  await del(`/maps/${slug}?forever=true`);
  location.reload();
}

/** Open the new map, or the page of its jobs if one is running. */
function goTo({ slug, job }) {
  location.assign(job ? `/maps/${slug}/jobs` : `/maps/${slug}/edit`);
}

function connectImport(button, input) {
  if (!button) return;
  const frame = document.getElementById("import-progress");
  const bar = frame.querySelector("progress");
  for (const one of [button, ...queryAll("[data-opens='import']", HTMLButtonElement)]) {
    one.addEventListener("click", () => input.click());
    one.disabled = false;
  }
  input.addEventListener("change", async () => {
    const body = new FormData();
    body.append("file", input.files[0]);
    frame.hidden = false;
    try {
      goTo(await upload("/maps/import", { body, onProgress: (sent, all) => Object.assign(bar, { value: sent, max: all }) }));
    } catch (error) {
      toastError(error);
    } finally {
      frame.hidden = true;
      input.value = "";
      bar.removeAttribute("value");
    }
  });
}
