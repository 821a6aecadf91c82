/** A menu at the pointer: arrow keys move in it, Escape and a click elsewhere close it. */

import { h, icon, queryAll } from "./dom.js";

const STEPS = { ArrowDown: 1, ArrowUp: -1 };
const EDGE = 8;

/** @typedef {{icon: string, label: string, run?: function(): void, href?: string, danger?: boolean}} Item */

/**
 * Open a context menu; an open one is closed.
 * @param {{x: number, y: number}} at in the window
 * @param {string} label for screen readers
 * @param {Array<Item|false|null>} items
 *   false and null are left out; an item with `href` is a link to another page
 */
export function openContextMenu(at, label, items) {
  document.querySelector(".context-menu")?.remove();
  const before = document.activeElement;
  const watch = new AbortController();
  const close = (back) => {
    watch.abort();
    menu.remove();
    if (back && before instanceof HTMLElement) before.focus();
  };
  const menu = h("div", { class: "menu__list context-menu", role: "menu", "aria-label": label },
    ...items.map((item) => item && entry(item, close)));
  document.body.append(menu);
  const { width, height } = menu.getBoundingClientRect();
  menu.style.left = `${Math.max(EDGE, Math.min(at.x, innerWidth - width - EDGE))}px`;
  menu.style.top = `${Math.max(EDGE, Math.min(at.y, innerHeight - height - EDGE))}px`;
  const entries = () => queryAll("[role=menuitem]", HTMLElement, menu);
  entries()[0]?.focus();
  menu.addEventListener("keydown", (event) => {
    const all = entries();
    const now = all.indexOf(/** @type {HTMLElement} */ (document.activeElement));
    const to = { Home: 0, End: all.length - 1 }[event.key] ?? (event.key in STEPS ? (now + STEPS[event.key] + all.length) % all.length : null);
    if (event.key === "Escape" || event.key === "Tab") close(true);
    else if (to !== null) all[to].focus();
    else return;
    event.preventDefault();
    event.stopPropagation();
  });
  const outside = (event) => menu.contains(event.target) || close(false);
  addEventListener("pointerdown", outside, { capture: true, signal: watch.signal });
  addEventListener("resize", () => close(false), { signal: watch.signal });
}

/** @param {Item} item @param {function(boolean): void} close */
function entry({ icon: name, label, run, href, danger }, close) {
  const look = { class: `menu__item${danger ? " menu__item--danger" : ""}`, role: "menuitem" };
  if (href) return h("a", { ...look, href, target: "_blank", rel: "noopener noreferrer", onclick: () => close(false) }, icon(name), label);
  const act = () => {
    close(true);
    run();
  };
  return h("button", { ...look, type: "button", onclick: act }, icon(name), label);
}
