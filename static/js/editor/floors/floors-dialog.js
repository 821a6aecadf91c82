/** The dialog to add, rename, order, align and remove floors, and set their images. */

import { ACCEPTED } from "../../shared/accepted.js";
import { busy, confirmDialog, errorLine, field, openDialog } from "../../shared/dialogs.js";
import { byId, h, icon } from "../../shared/dom.js";
import { t, tn } from "../../shared/i18n.js";
import { levelText } from "../../shared/map/floor-switch.js";
import { BASE_FLOOR } from "../../shared/map/map-store.js";

const MOST_NAME = 60;
const LARGEST_LEVEL = 1000;

/** Connect the item of the menu. @param {Object} page store, server and align */
export function connectFloors(page) {
  byId("floors-button").addEventListener("click", () => {
    if (page.store.satellite) new FloorsDialog(page);
  });
}

/** The dialog; each change is saved at once and can be undone by itself. */
class FloorsDialog {
  constructor({ store, server, align }) {
    this.store = store;
    this.server = server;
    this.align = align;
    this.error = errorLine();
    this.list = h("ul", { class: "floor-list" });
    const intro = h("p", { class: "soft" }, t("All floors share the pixels of the map’s image: a spot keeps its coordinates from floor to floor."));
    this._render();
    this.dialog = openDialog(t("Floors"), [intro, this.list, this._form(), this.error]);
    this.dialog.classList.add("dialog--wide");
  }

  _render() {
    const { floors } = this.store;
    const shown = floors.length ? floors : [{ id: BASE_FLOOR, name: t("Ground floor"), level: 0, height_m: null, url: null }];
    this.list.replaceChildren(...shown.toReversed().map((floor) => this._row(floor)));
    this.list.classList.toggle("is-alone", !floors.length);
  }

  _row(floor) {
    const { id } = floor;
    const saved = this.store.floors.length > 0;
    const inputs = this._inputs(floor);
    for (const [name, input] of Object.entries(inputs)) {
      if (saved) input.addEventListener("change", () => input.reportValidity() && this._save(() => this.server.changeFloor(id, { [name]: valueOf(input) })));
    }
    if (!saved) this.base = inputs;
    const count = this.store.order.filter((photo) => this.store.isPlaced(photo) && this.store.floorOf(photo) === id).length;
    const parts = [
      h("span", { class: "floor-row__photos small soft" }, tn("{n} photo", "{n} photos", count)),
      id === BASE_FLOOR && h("span", { class: "small soft" }, t("the map’s image")),
      id !== BASE_FLOOR && this._imageInput(floor),
      id !== BASE_FLOOR && floor.url && h("button", { class: "button button--quiet", type: "button", onclick: () => (this.dialog.close(), this.align.start(id)) }, icon("target"), t("Align …")),
      id !== BASE_FLOOR && h("button", { class: "icon-button", type: "button", title: t("Remove"), "aria-label": t("Remove {name}", { name: floor.name }), onclick: (event) => this._remove(event, floor, count) }, icon("trash")),
    ];
    return h("li", { class: "floor-row", dataset: { floor: id } },
      labelled(t("Level"), inputs.level), labelled(t("Name"), inputs.name), labelled(t("Height, m"), inputs.height_m),
      h("div", { class: "floor-row__more" }, ...parts.filter(Boolean)));
  }

  _inputs({ name, level, height_m: height }) {
    return {
      level: h("input", { class: "input number", type: "number", step: 0.5, min: -LARGEST_LEVEL, max: LARGEST_LEVEL, required: true, value: level }),
      name: h("input", { class: "input", maxlength: MOST_NAME, required: true, autocomplete: "off", value: name }),
      height_m: h("input", { class: "input number", type: "number", step: "any", value: height ?? "" }),
    };
  }

  _imageInput({ id, name, url }) {
    const words = url ? t("Replace the image") : t("Add an image");
    const input = h("input", { class: "ed-file", id: `floor-image-${id}`, type: "file", accept: ACCEPTED.map_images, "aria-label": `${words}: ${name}` });
    input.addEventListener("change", () => input.files[0] && this._save(() => this.server.setFloorImage(id, input.files[0])));
    return h("span", {}, input, h("label", { class: "button button--quiet", for: input.id }, icon("image"), words));
  }

  /** The form to add a floor, by default the next one above. */
  _form() {
    const next = Math.floor(Math.max(0, ...this.store.floors.map(({ level }) => level))) + 1;
    const inputs = this._inputs({ name: next === 1 ? t("1st floor") : t("Floor {n}", { n: levelText(next) }), level: next, height_m: null });
    const file = h("input", { class: "input", type: "file", accept: ACCEPTED.map_images, "data-testid": "floor-file" });
    inputs.name.dataset.testid = "floor-name";
    const add = h("button", { class: "button button--primary", type: "button", "data-testid": "floor-add" }, icon("plus"), t("Add the floor"));
    add.addEventListener("click", () => busy(add, async () => {
      if (![...Object.values(inputs), ...Object.values(this.base ?? {})].every((input) => input.reportValidity())) return;
      const base = this.base ? { base_name: this.base.name.value, base_level: valueOf(this.base.level) } : {};
      const known = new Set(this.store.floors.map(({ id }) => id));
      await this._save(async () => this.server.addFloor({ ...valuesOf(inputs), ...base, file: file.files[0] ?? null }));
      const added = this.store.floors.find(({ id }) => id !== BASE_FLOOR && !known.has(id));
      if (!added) return;
      this.base = null;
      this.store.showFloor(added.id);
      this.dialog.querySelector(".floor-form").replaceWith(this._form());
    }));
    return h("fieldset", { class: "floor-form" }, h("legend", {}, t("New floor")),
      h("div", { class: "floor-row" }, labelled(t("Level"), inputs.level), labelled(t("Name"), inputs.name), labelled(t("Height, m"), inputs.height_m)),
      field(t("Image"), file, t("A plan as PNG, JPEG or TIFF; it is stretched over the map’s image, and can be aligned. A GeoTIFF aligns itself.")), add);
  }

  async _remove(event, { id, name }, count) {
    const text = count ? tn("{n} photo on it goes back to the tray.", "{n} photos on it go back to the tray.", count) : "";
    if (!(await confirmDialog({ title: t("Remove {name}?", { name }), text, action: t("Remove") }))) return;
    await busy(event.target.closest("button"), () => this._save(() => this.server.removeFloor(id)));
  }

  async _save(run) {
    this.error.show(null);
    try {
      this.store.merge(await run());
    } catch (error) {
      this.error.show(error);
    }
    this._render();
  }
}

function labelled(words, input) {
  return h("label", { class: "floor-row__field" }, h("span", { class: "small soft" }, words), input);
}

function valueOf(input) {
  if (input.type !== "number") return input.value.trim();
  return input.value === "" ? null : Number(input.value);
}

function valuesOf(inputs) {
  return Object.fromEntries(Object.entries(inputs).map(([name, input]) => [name, valueOf(input)]));
}
