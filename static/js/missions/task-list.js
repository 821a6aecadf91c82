/** The objects as tasks: open or done, with buttons to set their state. */

import { byId, h, queryAll, targetOf } from "../shared/dom.js";
import { locale } from "../shared/i18n.js";
import { rafThrottle } from "../shared/timing.js";
import { isOpen, stateBadge, stateButtons, stateText } from "./object-states.js";

const ROWS = 100;
const NAMES = new Intl.Collator(locale, { numeric: true });

/** Tasks of the page's mission: confirmed ones first, then the latest found. */
export class TaskList {
  /**
   * @param {import("./mission-store.js").MissionStore} store
   * @param {function(Object): void} look called with the object chosen here
   */
  constructor(store, look) {
    this.store = store;
    this.look = look;
    this.open = true;
    this.rows = ROWS;
    this.list = byId("tasks");
    this.render = rafThrottle(() => this._render());
    for (const button of queryAll("[data-tasks]", HTMLButtonElement)) {
      button.addEventListener("click", () => this._show(button.dataset.tasks === "open"));
    }
    byId("tasks-more").addEventListener("click", () => {
      this.rows += ROWS;
      this.render();
    });
    this.list.addEventListener("click", (event) => {
      const button = targetOf(event).closest(".mi-object");
      if (button) this._choose(button.closest("li").dataset.key);
    });
    store.on("objects missions chosen", this.render);
    this.render();
  }

  _show(open) {
    this.open = open;
    this.rows = ROWS;
    this.render();
  }

  _render() {
    const own = [...this.store.objects.values()].filter(({ mission }) => mission === this.store.id);
    const open = own.filter(isOpen).sort(byUrgency);
    const done = own.filter((object) => !isOpen(object)).sort((a, b) => b.state_time_s - a.state_time_s || NAMES.compare(a.id, b.id));
    const shown = this.open ? open : done;
    for (const button of queryAll("[data-tasks]", HTMLButtonElement)) {
      button.setAttribute("aria-pressed", String((button.dataset.tasks === "open") === this.open));
    }
    byId("tasks-open").textContent = open.length.toLocaleString(locale);
    byId("tasks-done").textContent = done.length.toLocaleString(locale);
    byId("tab-tasks-count").textContent = open.length ? open.length.toLocaleString(locale) : "";
    byId("tasks-none").hidden = shown.length > 0;
    byId("tasks-more").hidden = shown.length <= this.rows;
    const focused = document.activeElement?.closest("#tasks li")?.getAttribute("data-key");
    this.list.replaceChildren(...shown.slice(0, this.rows).map((object) => this._item(object)));
    if (focused) queryAll(`li[data-key="${CSS.escape(focused)}"] .mi-object`, HTMLButtonElement, this.list)[0]?.focus();
  }

  _item(object) {
    const { key, id, kind, state } = object;
    const chosen = key === this.store.chosen;
    return h("li", { class: chosen ? "mi-task is-chosen" : "mi-task", dataset: { key }, "data-testid": "task" },
      h("div", { class: "mi-task__head" },
        h("button", { class: "mi-object", type: "button", "aria-pressed": String(chosen) }, this.store.symbols.element(kind), id),
        stateBadge(state)),
      h("p", { class: "small soft" }, [kind, stateText(object)].filter(Boolean).join(" · ")),
      h("div", { class: "mi-task__actions" }, ...stateButtons(this.store, object)));
  }

  _choose(key) {
    const object = this.store.objects.get(key);
    this.store.choose(key);
    if (object) this.look(object);
  }
}

function byUrgency(a, b) {
  return Number(b.state === "confirmed") - Number(a.state === "confirmed") || b.last_time_s - a.last_time_s || NAMES.compare(a.id, b.id);
}
