/** The fields of the printed tag at a control point. */

import { byId } from "../shared/dom.js";

/** @typedef {NonNullable<Api["ControlPointOut"]["tag"]>} Tag */

export class TagForm {
  #family = byId("tag-family", HTMLSelectElement);
  #mount = byId("tag-mount", HTMLSelectElement);
  #id = byId("tag-id", HTMLInputElement);
  #size = byId("tag-size", HTMLInputElement);
  #heading = byId("tag-heading", HTMLInputElement);

  /** @param {(tag: Tag | null) => void} changed Called with what was entered. */
  constructor(changed) {
    for (const field of this.#fields) field.addEventListener("change", () => this.#isValid && changed(this.#tag));
  }

  /** Show the tag of a point. @param {Api["ControlPointOut"] | undefined} point */
  show(point) {
    byId("tag").hidden = !point;
    const tag = point?.tag;
    for (const field of this.#fields.slice(1)) field.disabled = !tag;
    this.#family.value = tag?.family ?? "";
    if (!tag) return;
    this.#id.value = String(tag.id);
    this.#size.value = String(tag.size_mm);
    this.#mount.value = tag.mount;
    this.#heading.value = tag.heading_deg === null ? "" : String(tag.heading_deg);
  }

  get #fields() {
    return [this.#family, this.#id, this.#size, this.#mount, this.#heading];
  }

  get #isValid() {
    return this.#family.value === "" || this.#fields.every((field) => field.reportValidity());
  }

  /** @returns {Tag | null} */
  get #tag() {
    if (!this.#family.value) return null;
    const heading = this.#heading.valueAsNumber;
    return {
      family: /** @type {Tag["family"]} */ (this.#family.value),
      id: this.#id.valueAsNumber || 0,
      size_mm: this.#size.valueAsNumber,
      mount: /** @type {Tag["mount"]} */ (this.#mount.value),
      heading_deg: Number.isFinite(heading) ? heading : null,
    };
  }
}
