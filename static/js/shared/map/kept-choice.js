/** What somebody chose for a map, kept in this browser. */

/** Of a shared map nothing is kept: it has no slug, and its address is a secret. */
export class KeptChoice {
  /**
   * @param {string} name of what is chosen
   * @param {?string} [slug] of the map
   */
  constructor(name, slug) {
    this._key = slug ? `expmap.${name}.${slug}` : null;
    this._value = this._key && JSON.parse(localStorage.getItem(this._key) ?? "null");
  }

  /** What was chosen last; null for nothing. */
  get value() {
    return this._value;
  }

  set value(value) {
    this._value = value;
    if (!this._key) return;
    if (value === null) localStorage.removeItem(this._key);
    else localStorage.setItem(this._key, JSON.stringify(value));
  }
}
