/** Thumbnails next to a dot, while the mouse is on it. */

import { h } from "../../shared/dom.js";
import { tn } from "../../shared/i18n.js";
import { rafThrottle } from "../../shared/timing.js";

const SHOWN = 3;
const AWAY = 14;

/**
 * Connect the preview.
 * @param {import("../../shared/map/map-view.js").MapView} view
 * @param {import("../../shared/map/photo-dots.js").PhotoDots} dots
 * @param {{gesture: ?Object}} gestures nothing is shown during a gesture
 */
export function previewDots(view, dots, gestures) {
  const { element, map, store } = view;
  const card = element.appendChild(h("div", { class: "ed-preview", hidden: true, "aria-hidden": "true" }));
  /** @type {?PointerEvent} */
  let last = null;
  const show = rafThrottle(() => {
    const point = last && map.mouseEventToContainerPoint(last);
    const ids = point && !gestures.gesture ? dots.near(point).filter((id) => store.isKnown(id)) : [];
    card.hidden = !ids.length;
    if (!ids.length) return;
    if (card.dataset.ids !== ids.join()) card.replaceChildren(...content(ids, store));
    card.dataset.ids = ids.join();
    const { x: width, y: height } = map.getSize();
    const [left, above] = [point.x > width / 2, point.y > height / 2];
    card.style.translate = `${left ? "-100%" : "0"} ${above ? "-100%" : "0"}`;
    card.style.left = `${point.x + (left ? -AWAY : AWAY)}px`;
    card.style.top = `${point.y + (above ? -AWAY : AWAY)}px`;
  });
  element.addEventListener("pointermove", (event) => {
    last = event.pointerType === "touch" ? null : event;
    show();
  });
  for (const end of ["pointerleave", "pointerdown"]) {
    element.addEventListener(end, () => {
      last = null;
      show();
    });
  }
}

function content(ids, store) {
  const photos = ids.slice(0, SHOWN).map((id) => store.photos.get(id));
  const more = ids.length - photos.length;
  return [
    ...photos.map(({ thumb, name }) => h("figure", {}, h("img", { src: thumb, alt: "" }), h("figcaption", {}, name))),
    more > 0 && h("p", { class: "small" }, tn("and {n} more", "and {n} more", more)),
  ].filter(Boolean);
}
