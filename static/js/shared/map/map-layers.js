/** The layers of a map: its image with adjustable opacity over the tiles of a chosen service. */

import { byId } from "../dom.js";
import { t } from "../i18n.js";
import { KeptChoice } from "./kept-choice.js";

/** Initial opacity of the image over tiles, percent. */
const OVER_TILES = 60;

/** Delay of a choice by keyboard, so that options passed on the way load no tiles. */
const KEY_PAUSE_MS = 600;

/** Connects the menu; no tiles are fetched before a service is chosen. */
export class MapLayers {
  /** @param {import("./map-view.js").MapView} view */
  constructor(view) {
    this.store = view.store;
    this.views = [view];
    this.kept = new KeptChoice("layers", this.store.slug);
    this.menu = byId("layers", HTMLDetailsElement);
    this.select = byId("layer-below", HTMLSelectElement);
    this.opacity = byId("image-opacity", HTMLInputElement);
    this.status = byId("layers-status");
    this.counts = new Map();
    let pause = 0;
    let later;
    this.select.addEventListener("pointerdown", () => (pause = 0));
    this.select.addEventListener("keydown", () => (pause = KEY_PAUSE_MS));
    this.select.addEventListener("change", () => {
      clearTimeout(later);
      if (pause) later = setTimeout(() => this._choose(), pause);
      else this._choose();
    });
    this.opacity.addEventListener("input", () => this._show());
    this.opacity.addEventListener("change", () => this._keep());
    view.element.addEventListener("pointerdown", () => (this.menu.open = false));
    this.store.on("satellite", () => this._show());
    this._remember();
    this._show();
  }

  /** Show the same layers on another map of the same image. @param {import("./map-view.js").MapView} view */
  follow(view) {
    this.views.push(view);
    this._show();
  }

  /** The tile service below the image, or null. */
  get service() {
    const { url, attribution, maxZoom } = this.select.selectedOptions[0].dataset;
    return url ? { name: this.select.value, url, attribution, maxZoom: Number(maxZoom) } : null;
  }

  _choose() {
    this.counts.clear();
    this._say();
    if (this.opacity.disabled) this.opacity.valueAsNumber = OVER_TILES;
    this._show();
    this._keep();
  }

  /** Show the chosen layers; only a georeferenced image can be laid over tiles. */
  _show() {
    this.menu.hidden = !this.store.georeference.grid || this.select.options.length < 2;
    const service = this.menu.hidden ? null : this.service;
    this.opacity.disabled = !service;
    const opacity = service ? this.opacity.valueAsNumber / 100 : 1;
    for (const view of this.views) view.showBackground(service, opacity, (counts) => this._arrived(service, view, counts));
  }

  _arrived(service, view, counts) {
    if (service.name !== this.service?.name) return;
    this.counts.set(view, counts);
    this._say();
  }

  _say() {
    const { service } = this;
    const sum = (name) => [...this.counts.values()].reduce((all, counts) => all + counts[name], 0);
    const [shown, failed] = [sum("shown"), sum("failed")];
    this.status.textContent = failed && !shown ? t("No map of this place came from {host}.", { host: new URL(service.url.replaceAll(/[{}]/g, ""), location.href).host }) : "";
  }

  _keep() {
    this.kept.value = this.service && { name: this.select.value, opacity: this.opacity.valueAsNumber };
  }

  /** Restore the last choice on this map, unless its service is no longer offered. */
  _remember() {
    const kept = this.kept.value;
    if (!kept) return;
    this.select.value = kept.name;
    if (this.select.selectedIndex < 0) this.select.selectedIndex = 0;
    else this.opacity.valueAsNumber = kept.opacity;
  }
}
