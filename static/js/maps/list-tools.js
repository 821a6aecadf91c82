/** Search and sort in the list of maps, and what is done with several of them. */

import { del } from "../shared/api.js";
import { busy, confirmDialog } from "../shared/dialogs.js";
import { byId, queryAll } from "../shared/dom.js";
import { locale, t, tn } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";

const KEPT = "expmap.maps-sort";
const names = new Intl.Collator(locale, { numeric: true });

/** Connect the tools; a list of one map has none. */
export function connectTools() {
  if (!document.getElementById("maps-search")) return;
  const list = byId("maps");
  const cards = queryAll(":scope > [data-slug]", HTMLElement, list);
  search(byId("maps-search", HTMLInputElement), cards);
  sort(byId("maps-sort", HTMLSelectElement), list, cards);
  choose(byId("maps-choose", HTMLButtonElement), list, cards);
}

function search(input, cards) {
  const find = () => {
    const wanted = plain(input.value.trim());
    for (const card of cards) card.hidden = !plain(card.dataset.name).includes(wanted);
    byId("maps-none").hidden = cards.some((card) => !card.hidden);
  };
  input.addEventListener("input", find);
  input.disabled = false;
  find();
}

/** Without case and accents. @param {string} text */
function plain(text) {
  return text.normalize("NFD").replace(/\p{Mn}/gu, "").toLocaleLowerCase(locale);
}

function sort(select, list, cards) {
  const orders = {
    changed: () => cards,
    name: () => cards.toSorted((a, b) => names.compare(a.dataset.name, b.dataset.name)),
    photos: () => cards.toSorted((a, b) => Number(b.dataset.photos) - Number(a.dataset.photos)),
  };
  const show = () => list.append(...orders[select.value]());
  const kept = localStorage.getItem(KEPT);
  if (kept in orders) select.value = kept;
  select.addEventListener("change", () => {
    localStorage.setItem(KEPT, select.value);
    show();
  });
  select.disabled = false;
  if (select.value !== "changed") show();
}

function choose(button, list, cards) {
  const boxes = queryAll(".map-card__pick input", HTMLInputElement, list);
  const chosen = () => cards.filter((card) => boxes.some((box) => box.checked && card.contains(box)));
  const bin = byId("maps-bin", HTMLButtonElement);
  const render = () => {
    const on = button.getAttribute("aria-pressed") === "true";
    list.classList.toggle("is-choosing", on);
    byId("maps-bar").hidden = !on;
    byId("maps-count").textContent = tn("{n} selected", "{n} selected", chosen().length);
    bin.disabled = !chosen().length;
  };
  button.addEventListener("click", () => {
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(on));
    for (const box of boxes) box.checked = false;
    render();
  });
  list.addEventListener("change", render);
  bin.addEventListener("click", () => busy(bin, () => toBin(chosen())).catch(toastError));
  button.hidden = !boxes.length;
  button.disabled = false;
}

async function toBin(cards) {
  const title = tn("Move {n} map to the bin?", "Move {n} maps to the bin?", cards.length);
  if (!(await confirmDialog({ title, text: t("They can be restored from there."), action: t("Move to the bin") }))) return;
  for (const { dataset } of cards) await del(`/maps/${dataset.slug}`);
  location.reload();
}
