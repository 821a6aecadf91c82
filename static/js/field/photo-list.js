/** The photos of this device as a list: waiting, answered, added or refused. */

import { answerBadge } from "../shared/answer/answer-badge.js";
import { h, icon, queryAll } from "../shared/dom.js";
import { moment, t } from "../shared/i18n.js";

/** Shows the entries of the outbox, the newest first. */
export class PhotoList {
  /**
   * @param {HTMLElement} list
   * @param {{open: function(Object): void, remove: function(Object): void}} on
   */
  constructor(list, on) {
    this.list = list;
    this.on = on;
    this.current = null;
    this.pictures = new Map();
  }

  /** @param {import("./outbox.js").Entry[]} entries */
  show(entries) {
    for (const [key, address] of this.pictures) {
      if (entries.some((entry) => entry.key === key)) continue;
      URL.revokeObjectURL(address);
      this.pictures.delete(key);
    }
    this.list.replaceChildren(...[...entries].reverse().map((entry) => this._item(entry)));
  }

  /** @param {?string} key of the entry whose answer is shown */
  mark(key) {
    this.current = key;
    for (const item of queryAll("[data-key]", HTMLElement, this.list)) item.dataset.current = String(item.dataset.key === key);
  }

  _item(entry) {
    const answered = entry.state === "answered";
    const props = { class: "fi-photo__open", ...(answered ? { type: "button", onclick: () => this.on.open(entry) } : {}) };
    return h("li", { class: "fi-photo", "data-testid": "field-photo", dataset: { key: entry.key, state: entry.state, current: entry.key === this.current } },
      h(answered ? "button" : "div", props,
        this._picture(entry),
        h("span", { class: "fi-photo__text" },
          h("span", { class: "fi-photo__name" }, entry.name),
          h("span", { class: "small soft" }, about(entry))),
        badge(entry)),
      entry.state === "refused" && h("button", { class: "icon-button", type: "button", "aria-label": t("Remove {name}", { name: entry.name }), onclick: () => this.on.remove(entry) }, icon("trash")));
  }

  _picture({ key, thumb }) {
    if (!thumb) return h("span", { class: "fi-photo__picture" });
    if (!this.pictures.has(key)) this.pictures.set(key, URL.createObjectURL(thumb));
    return h("img", { class: "fi-photo__picture", src: this.pictures.get(key), alt: "" });
  }
}

function about({ state, error, map, at }) {
  return state === "refused" ? error : `${map} · ${moment(at)}`;
}

function badge({ state, answer }) {
  if (state === "waiting") return h("span", { class: "badge badge--warning" }, t("waiting"));
  if (state === "added") return h("span", { class: "badge badge--success" }, t("added"));
  if (state === "refused") return h("span", { class: "badge badge--danger" }, t("rejected"));
  return answerBadge(answer);
}
