/** Colours of the style sheet for a canvas; they change with the theme. */

/** Caches the colours until the theme changes. */
export class ThemeColours {
  /**
   * @param {HTMLElement} element where the variables are defined
   * @param {string[]} names of variables, such as `--mi-grid-strong`, which becomes `gridStrong`
   * @param {function(): void} changed
   */
  constructor(element, names, changed) {
    this.element = element;
    this.names = names;
    this._found = null;
    const forget = () => {
      this.forget();
      changed();
    };
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", forget);
    new MutationObserver(forget).observe(document.documentElement, { attributeFilter: ["data-theme"] });
  }

  forget() {
    this._found = null;
  }

  /** All colours by name. @returns {Object<string, string>} */
  get all() {
    this._found ??= this._look();
    return this._found;
  }

  /** A variable may contain `light-dark(..)`: only a property that uses it resolves to the colour. */
  _look() {
    const probe = this.element.appendChild(document.createElement("span"));
    const found = this.names.map((name) => {
      probe.style.color = `var(${name})`;
      return [name.replace(/^--(mi-)?/, "").replace(/-(.)/g, (_, letter) => letter.toUpperCase()), getComputedStyle(probe).color];
    });
    probe.remove();
    return Object.fromEntries(found);
  }
}
