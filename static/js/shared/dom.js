/** Small helpers for finding and making elements. */

const SVG = "http://www.w3.org/2000/svg";

/**
 * Find an element that must exist in the page.
 * @template {HTMLElement} T
 * @param {string} id
 * @param {{new(): T}} [kind] required class of the element
 * @returns {T}
 */
export function byId(id, kind) {
  const found = document.getElementById(id);
  if (!(found instanceof (kind ?? HTMLElement))) throw new Error(`the page has no ${kind?.name ?? "element"} #${id}`);
  return /** @type {T} */ (found);
}

/**
 * Find elements.
 * @template {HTMLElement} T
 * @param {string} selector
 * @param {{new(): T}} [kind] class of the elements; others are left out
 * @param {ParentNode} [root]
 * @returns {T[]}
 */
export function queryAll(selector, kind, root = document) {
  const found = [...root.querySelectorAll(selector)];
  return /** @type {T[]} */ (found.filter((element) => element instanceof (kind ?? HTMLElement)));
}

/**
 * The target element of an event.
 * @template {HTMLElement} T
 * @param {Event} event
 * @param {{new(): T}} [kind] required class of the element
 * @returns {T}
 */
export function targetOf(event, kind) {
  if (!(event.target instanceof (kind ?? Element))) throw new Error(`no ${kind?.name ?? "element"} has had this ${event.type}`);
  return /** @type {T} */ (event.target);
}

/** The `<meta>` element of a name; pages for visitors lack some. @param {string} name @returns {?HTMLMetaElement} */
export function metaOf(name) {
  return document.querySelector(`meta[name="${name}"]`);
}

/**
 * Make an element.
 * @template {keyof HTMLElementTagNameMap} K
 * @param {K} tag
 * @param {Object<string, *>} [props] `class`, `dataset`, `on<event>` listeners; the rest are attributes
 *   (true: present; false, null, undefined: left out)
 * @param {...(Node|string|number|null|undefined|false)} children null, undefined and false are left out
 * @returns {HTMLElementTagNameMap[K]}
 */
export function h(tag, props = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "dataset") Object.assign(made.dataset, value);
    else if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else made.setAttribute(name, value === true ? "" : String(value));
  }
  for (const child of children) {
    if (child !== null && child !== undefined && child !== false) made.append(child instanceof Node ? child : String(child));
  }
  return made;
}

/**
 * Make an icon that is hidden from screen readers.
 * @param {string} name of a symbol in static/img/icons.svg
 * @returns {SVGElement}
 */
export function icon(name) {
  return svg("svg", { class: "icon", "aria-hidden": "true" }, svg("use", { href: iconAddress(name) }));
}

/**
 * Make an SVG element.
 * @param {string} tag
 * @param {Object<string, *>} attributes
 * @param {...SVGElement} children
 * @returns {SVGElement}
 */
export function svg(tag, attributes, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, String(value));
  made.append(...children);
  return made;
}

/** Address of a symbol of static/img/icons.svg. @param {string} name */
export function iconAddress(name) {
  return `${metaOf("expmap-icons").content}#${name}`;
}

/**
 * Close an open menu (`<details class="menu">`) by a click elsewhere or Escape.
 * @param {Document} page
 */
export function closeMenus(page) {
  const open = () => queryAll("details.menu[open]", HTMLDetailsElement, page);
  page.addEventListener("click", (event) => {
    for (const menu of open()) if (!menu.contains(targetOf(event))) menu.open = false;
  });
  const escape = (event) => {
    if (event.key !== "Escape") return;
    for (const menu of open()) {
      event.preventDefault(); // handled here: others ignore this Escape
      menu.open = false;
      menu.querySelector("summary").focus();
    }
  };
  page.addEventListener("keydown", escape, { capture: true });
}

/** Prevent the browser's own drag of selected text, which would cancel the pointer events of a drag. */
export function preventTextDrag(element) {
  element.addEventListener("dragstart", (event) => event.preventDefault());
}

/** Whether key presses in an element enter text or change its value. */
export function takesText(element) {
  if (!(element instanceof HTMLElement)) return false;
  if (element.isContentEditable || element.matches("textarea, select")) return true;
  return element.matches("input:not([type=checkbox], [type=radio], [type=button], [type=range], [type=file])");
}
