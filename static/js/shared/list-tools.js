/** Search, sort and bulk actions in a list of cards; the controls are those of the macro `list_tools`. */

import { busy } from "./dialogs.js";
import { byId, h, queryAll } from "./dom.js";
import { locale, t, tn } from "./i18n.js";
import { toast, toastError } from "./toast.js";

const PAUSE_MS = 200; // after the last key, before the server is asked

const names = new Intl.Collator(locale, { numeric: true });

/** Compares cards by their names. @param {HTMLElement} a @param {HTMLElement} b */
export const byName = (a, b) => names.compare(a.dataset.name, b.dataset.name);

/** Compares cards by a number, the largest first. @param {string} field of `dataset` */
export const largest = (field) => (a, b) => Number(b.dataset[field]) - Number(a.dataset[field]);

/**
 * @typedef {Object} Actions
 * @property {string} kept key in the browser's storage for the chosen order
 * @property {Object<string, function(HTMLElement, HTMLElement): number>} orders by the value of the selection; for other values, the server's order
 * @property {function(string): Promise<*>} bin
 * @property {function(string): Promise<*>} restore
 * @property {function(number): string} binned message after as many cards were moved to the bin
 * @property {function(): Promise<*>} [whole] loads the rest of a list that is shown in part
 * @property {function(string): Promise<*>} [search] loads the cards of such a list that match a text; an empty text matches all
 */

/** The tools of one list. Cards have `data-key`, `data-name`, the address `data-file`, and a checkbox `data-pick` if they can be selected. */
export class ListTools {
  /** @param {HTMLElement} list @param {Actions} actions */
  constructor(list, actions) {
    this.list = list;
    this.actions = actions;
    this.isWhole = !actions.whole;
    this.searched = ""; // text for which the server found the present cards
    this.timer = 0;
    this.input = byId("list-search", HTMLInputElement);
    this.select = byId("list-sort", HTMLSelectElement);
    this.chooser = byId("list-choose", HTMLButtonElement);
    const kept = localStorage.getItem(actions.kept);
    if (kept in actions.orders) this.select.value = kept;
    this.input.addEventListener("input", () => this._show().catch(toastError));
    this.select.addEventListener("change", () => {
      localStorage.setItem(actions.kept, this.select.value);
      this._show().catch(toastError);
    });
    this.chooser.addEventListener("click", () => this._choose());
    list.addEventListener("change", () => this._bar());
    byId("list-all").addEventListener("click", () => this._all());
    byId("list-download").addEventListener("click", () => this._download());
    byId("list-bin").addEventListener("click", ({ currentTarget }) => busy(currentTarget, () => this.toBin(this._chosen())).catch(toastError));
    for (const control of [this.input, this.select, this.chooser]) control.disabled = false;
    /** @type {HTMLElement[]} */
    this.cards = [];
    if (!actions.whole) this.refresh();
  }

  /** Read the cards anew. @param {{whole?: boolean, searched?: string}} [now] whether the list is complete, and the text for which the server found it */
  refresh({ whole = !this.actions.whole, searched = "" } = {}) {
    this.isWhole = whole;
    this.searched = searched;
    this.cards = queryAll(":scope > [data-key]", HTMLElement, this.list); // in the order of the server
    this._show().catch(toastError);
  }

  /** Sort and filter the cards. Sorting loads the whole list first; the server searches an incomplete list. */
  async _show() {
    const text = this.input.value.trim();
    const wanted = plain(text);
    const order = this.actions.orders[this.select.value];
    const isPart = !this.isWhole || this.searched !== "";
    clearTimeout(this.timer);
    if (isPart && order) return this._fetchAll();
    if (isPart && this.actions.search && text !== this.searched) {
      this.timer = setTimeout(() => this.actions.search(text).catch(toastError), PAUSE_MS);
      return null;
    }
    const isFound = (card) => this.searched !== "" || plain(card.dataset.search || card.dataset.name).includes(wanted);
    for (const card of this.cards) card.hidden = !isFound(card);
    const now = order ? this.cards.toSorted(order) : this.cards;
    if (now.some((card, place) => this.list.children[place] !== card)) this.list.append(...now);
    byId("list-none").hidden = !wanted || this.cards.some((card) => !card.hidden);
    this._bar();
    return null;
  }

  async _fetchAll() {
    const { isWhole, searched } = this;
    Object.assign(this, { isWhole: true, searched: "" }); // so that they are not requested twice
    try {
      await this.actions.whole();
    } catch (error) {
      Object.assign(this, { isWhole, searched });
      throw error;
    }
  }

  get _isChoosing() {
    return this.chooser.getAttribute("aria-pressed") === "true";
  }

  get _boxes() {
    return queryAll("[data-pick]", HTMLInputElement, this.list);
  }

  _chosen() {
    return this.cards.filter((card) => !card.hidden && this._boxes.some((box) => box.checked && card.contains(box)));
  }

  _choose() {
    this.chooser.setAttribute("aria-pressed", String(!this._isChoosing));
    for (const box of this._boxes) box.checked = false;
    this._bar();
  }

  _all() {
    for (const box of this._boxes) box.checked = !/** @type {HTMLElement} */ (box.closest("[data-key]")).hidden;
    this._bar();
  }

  _bar() {
    this.chooser.hidden = !this._boxes.length;
    const chosen = this._chosen();
    this.list.classList.toggle("is-choosing", this._isChoosing);
    byId("list-bar").hidden = !this._isChoosing;
    byId("list-count").textContent = tn("{n} selected", "{n} selected", chosen.length);
    byId("list-bin", HTMLButtonElement).disabled = !chosen.length;
    byId("list-download", HTMLButtonElement).disabled = !chosen.some(({ dataset }) => dataset.file);
  }

  /** One file each; the browser asks once whether it may save several. */
  _download() {
    for (const { dataset } of this._chosen()) {
      if (!dataset.file) continue;
      const link = h("a", { href: dataset.file, download: true, hidden: true });
      document.body.append(link);
      link.click();
      link.remove();
    }
  }

  /** Move cards to the bin; the message offers to undo it. @param {HTMLElement[]} cards */
  async toBin(cards) {
    const done = [];
    try {
      for (const card of cards) {
        await this.actions.bin(card.dataset.key);
        done.push(card);
      }
    } finally {
      this._leave(done);
    }
  }

  _leave(cards) {
    if (!cards.length) return;
    const { cards: before, searched } = this;
    const next = before[before.indexOf(cards.at(-1)) + 1] ?? before[before.indexOf(cards[0]) - 1];
    this._keep(before.filter((card) => !cards.includes(card)));
    countBinned(cards.length);
    (next?.querySelector("a") ?? this.input).focus();
    const undo = async () => {
      const back = [];
      try {
        for (const card of cards) {
          await this.actions.restore(card.dataset.key);
          back.push(card);
        }
      } finally {
        countBinned(-back.length);
        if (this.searched === searched) this._keep(withThem(this.cards, back, before));
        else await this.actions.search(this.searched); // they may not match the present search
      }
    };
    toast(this.actions.binned(cards.length), { action: { label: t("Undo"), run: () => undo().catch(toastError) } });
  }

  _keep(cards) {
    for (const box of this._boxes) box.checked = false;
    this.cards = cards;
    this.list.replaceChildren(...cards);
    const empty = document.getElementById("empty");
    if (empty) empty.hidden = cards.length > 0 || !this.isWhole || this.searched !== "";
    this._show().catch(toastError);
  }
}

/** Reinsert cards after those that they followed before. @param {HTMLElement[]} cards @param {HTMLElement[]} back @param {HTMLElement[]} before */
function withThem(cards, back, before) {
  const all = [...cards];
  for (const card of back) {
    const earlier = before.slice(0, before.indexOf(card)).findLast((one) => all.includes(one));
    all.splice(earlier ? all.indexOf(earlier) + 1 : 0, 0, card);
  }
  return all;
}

/** Text in lower case without accents. @param {string} text */
function plain(text) {
  return text.normalize("NFD").replace(/\p{Mn}/gu, "").toLocaleLowerCase(locale);
}

/** Update the count in the page's link to the bin. @param {number} more */
function countBinned(more) {
  const count = byId("bin-count");
  const now = Number(count.textContent) + more;
  count.textContent = String(now);
  byId("bin-link").hidden = now <= 0;
}
