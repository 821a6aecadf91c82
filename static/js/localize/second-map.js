/** A second placement of the same photos next to the exact one: "which part of the map?". */

import { AnswerLayer } from "../shared/answer/answer-layer.js";
import { byId, h } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { MapStore } from "../shared/map/map-store.js";
import { MapView } from "../shared/map/map-view.js";
import { AnswerGestures } from "./gestures.js";

/**
 * Connect the selection of the second placement.
 * @param {{store: MapStore, session: import("../shared/answer/query-session.js").QuerySession, say: function(string): void}} page
 * @param {{follow: function(MapView): void}[]} followed controls that also apply to the second map: north up, layers
 */
export function connectSecondMap({ store, session, say }, followed) {
  const select = byId("beside", HTMLSelectElement);
  let second = null;
  const choices = () => {
    const names = [...store.placements.keys()];
    const shown = JSON.stringify(names);
    if (select.dataset.shown === shown) return;
    select.dataset.shown = shown;
    const chosen = select.value;
    select.replaceChildren(h("option", { value: "" }, t("nothing")), ...names.map((name) => h("option", { value: name }, name)));
    if (names.includes(chosen)) select.value = chosen;
    select.parentElement.hidden = !names.length;
    show();
  };
  const show = () => {
    const name = select.value;
    byId("maps").classList.toggle("has-two", Boolean(name));
    if (name) second ??= make({ store, session, say }, followed);
    second?.show(name);
    second?.showFloor();
  };
  select.addEventListener("change", show);
  store.on("photos", () => {
    second?.update();
    choices();
  });
  store.on("floor", () => second?.showFloor());
  choices();
}

/** Make the second map; it is hidden while no placement is chosen. */
function make({ store, session, say }, followed) {
  const label = t("The same photos in another placement");
  const canvas = h("div", { class: "ed-canvas", id: "map-canvas-2", tabindex: 0, role: "application", "aria-label": label });
  const title = h("p", { class: "lo-map__name" });
  const section = h("section", { class: "ed-map lo-map", "aria-label": label }, canvas, title);
  byId("maps").append(section);
  const other = new MapStore(stateOf(store));
  const view = new MapView(canvas, other);
  for (const one of followed) one.follow(view);
  const marks = new AnswerLayer(other, session).addTo(view.map);
  new AnswerGestures(view, marks, session, say);
  return {
    show: (name) => {
      section.hidden = !name;
      title.textContent = name;
      if (name) other.showPlacement(name);
    },
    update: () => other.merge(changesOf(store)),
    showFloor: () => other.showFloor(store.floor),
  };
}

function stateOf(store) {
  return {
    slug: store.slug, name: store.name, can_edit: false, revision: store.revision, ...changesOf(store),
    satellite: store.satellite, georeference: store.georeference.state, undo: null, redo: null,
  };
}

function changesOf(store) {
  return {
    photos: [...store.photos.values()],
    floors: store.floors,
    placements: [...store.placements].map(([name, placed]) => ({ name, positions: Object.fromEntries(placed) })),
  };
}
