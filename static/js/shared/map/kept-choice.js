/** A choice for a map, kept in this browser. */

/** A stored choice. Nothing is stored for a shared map: it has no slug, and its address is secret. */
export class KeptChoice {
  /**
   * @param {string} name of what is chosen
   * @param {?string} [slug] of the map
   */
  constructor(name, slug) {
    this._key = slug ? `expmap.${name}.${slug}` : null;
    this._value = this._key && JSON.parse(localStorage.getItem(this._key) ?? "null");
  }

  /** The last choice; null if none. */
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
