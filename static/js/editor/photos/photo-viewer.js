/** The current photo in full screen, with keys. */

import { h, icon } from "../../shared/dom.js";
import { clockText } from "../../shared/format.js";
import { t } from "../../shared/i18n.js";
import { creditLine } from "../../shared/photo-credit.js";
import { insideOf, PanoramaView } from "../../shared/panorama-view.js";
import { PhotoZoom } from "../../shared/photo-zoom.js";
import { ProgressiveImage } from "../../shared/progressive-image.js";

/** Open the viewer. @param {import("../commands.js").Commands} commands */
export function openViewer(commands) {
  const { store } = commands;
  if (!store.current?.preview || document.querySelector("dialog[open]")) return;
  const image = h("img", { alt: "", draggable: "false" });
  const frame = h("div", { class: "ed-frame viewer__frame" }, image, h("p", { class: "ed-frame__broken" }, t("This photo cannot be shown.")));
  const picture = new ProgressiveImage(frame, image);
  const zoom = new PhotoZoom(frame, image);
  const around = new PanoramaView(image);
  const step = (direction) => (around.isShown ? around : zoom).step(direction);
  const name = h("h2", { class: "viewer__name" });
  const about = h("p", { class: "small viewer__about" });
  const button = (symbol, words, run) => h("button", { class: "icon-button", type: "button", "aria-label": words, title: words, onclick: run }, icon(symbol));
  const dialog = h("dialog", { class: "viewer", "aria-label": t("Full-screen photo") },
    frame,
    h("div", { class: "viewer__bar" },
      button("chevron-left", t("Previous photo"), () => commands.step(-1)),
      button("chevron-right", t("Next photo"), () => commands.step(1)),
      h("div", { class: "viewer__words" }, name, about),
      button("minus", t("Zoom out of the photo"), () => step(-1)),
      button("plus", t("Zoom in on the photo"), () => step(1)),
      button("close", t("Close"), () => dialog.close())));
  const show = () => {
    const photo = store.current;
    if (!photo) return dialog.close();
    zoom.reset();
    picture.show(photo);
    around.show(insideOf(photo, store.heading(photo.id)), store.look?.id === photo.id ? store.look.turn : 0);
    name.textContent = photo.name;
    const when = photo.taken_at ? clockText(photo.taken_at) : "";
    about.replaceChildren(when, ...(photo.source ? [when && " · ", creditLine(photo.source)] : []));
    return undefined;
  };
  const keys = {
    ArrowRight: () => commands.step(1), n: () => commands.step(1), ArrowLeft: () => commands.step(-1), p: () => commands.step(-1),
    "+": () => step(1), "=": () => step(1), "-": () => step(-1), 0: () => zoom.reset(), f: () => dialog.close(),
  };
  dialog.addEventListener("keydown", (event) => {
    if (!(event.key in keys) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    keys[event.key]();
  });
  const watch = new AbortController();
  store.addEventListener("current", show, { signal: watch.signal });
  around.addEventListener("look", () => store.setLook({ id: store.currentId, turn: around.turn, fov: around.fov }));
  dialog.addEventListener("close", () => {
    watch.abort();
    around.close();
    dialog.remove();
  });
  document.body.append(dialog);
  show();
  dialog.showModal();
}
