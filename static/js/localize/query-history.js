/** Earlier queries of this map: thumbnails, each a link to its answer. */

import { answerBadge } from "../shared/answer/answer-badge.js";
import { byId, h, icon, queryAll } from "../shared/dom.js";
import { moment, t } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";

const PAGE = 30;

/** The list in the tab *History*, loaded when it is shown. */
export class QueryHistory {
  /**
   * @param {{session: import("../shared/answer/query-session.js").QuerySession, server: Object}} page
   * @param {function(number): void} open
   */
  constructor({ session, server }, open) {
    this.session = session;
    this.server = server;
    this.open = open;
    this.queries = [];
    this.stale = true;
    byId("history-more").addEventListener("click", () => this._read(this.queries.at(-1).id));
    session.on("query", () => this._mark());
  }

  /** Reload the list now if it is visible, else when it is shown next. */
  refresh() {
    this.stale = true;
    if (!byId("panel-history").hidden) this.show();
  }

  show() {
    if (this.stale) this._read(null);
  }

  async _read(before) {
    try {
      const { queries } = await this.server.history(before);
      this.queries = before ? [...this.queries, ...queries] : queries;
      this.stale = false;
      byId("history").replaceChildren(...this.queries.map((query) => this._entry(query)));
      byId("history-none").hidden = this.queries.length > 0;
      byId("history-more").hidden = queries.length < PAGE;
      this._mark();
    } catch (error) {
      toastError(error);
    }
  }

  _entry(query) {
    const open = (event) => {
      if (event.ctrlKey || event.metaKey || event.shiftKey) return;
      event.preventDefault();
      this.open(query.id);
    };
    return h("li", { dataset: { id: query.id } },
      h("a", { class: "lo-past", href: `?query=${query.id}`, onclick: open },
        h("img", { class: "ed-thumb", src: query.thumb, alt: "", loading: "lazy" }),
        h("span", { class: "lo-past__text" },
          h("span", { class: "lo-past__name" }, query.name),
          h("span", { class: "small soft" }, [query.who, moment(query.at)].filter(Boolean).join(" · "))),
        query.adopted !== null && h("span", { class: "lo-past__in", title: t("In the map") }, icon("check")),
        answerBadge(query.answer)));
  }

  _mark() {
    for (const item of queryAll("[data-id]", HTMLElement, byId("history"))) {
      const current = Number(item.dataset.id) === this.session.query?.id;
      item.firstElementChild.toggleAttribute("aria-current", current);
    }
  }
}
