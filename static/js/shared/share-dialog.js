/** What a link to a map or to an answer shares, and its address. */

import { post } from "./api.js";
import { busy, errorLine, openDialog } from "./dialogs.js";
import { h, icon, queryAll } from "./dom.js";
import { isLoopback } from "./format.js";
import { t } from "./i18n.js";

/**
 * Ask what a link to an answer shares, and show its address.
 * @param {{slug: string, query: number}} answer
 */
export function shareAnswer({ slug, query }) {
  const { element, wish } = linkForm({ query, in3d: false });
  const error = errorLine();
  const make = h("button", { class: "button button--primary", type: "button" }, icon("link"), t("Create the link"));
  const about = h("p", { class: "soft" }, t("Anyone with the link sees it without an account. You can revoke it at any time under Share."));
  const dialog = openDialog(t("Share this answer"), [about, element, error], { actions: [make] });
  make.addEventListener("click", () => busy(make, async () => {
    try {
      error.show(null);
      const share = await post(`/maps/${encodeURIComponent(slug)}/shares`, wish());
      dialog.close();
      showAddress(share);
    } catch (problem) {
      error.show(problem);
    }
  }));
}

/**
 * What a new link shares, and whether it is public.
 * @param {{query: ?number, in3d: boolean}} what `query` is the id of an answer; `in3d` whether the map has landmarks
 */
export function linkForm({ query, in3d }) {
  const element = h("fieldset", { class: "share-ways" },
    h("legend", { class: "visually-hidden" }, t("What is shared")),
    ...allowed({ query, in3d }),
    box("public", t("Also list it under public maps"), { hint: t("Everyone can find it there.") }));
  return { element, wish: () => ({ query, ...checked(element) }) };
}

/** Show address and tag of a share. @param {Object} share as returned by the server */
export function showAddress(share) {
  const once = h("p", { class: "soft" }, t("This address is shown only once: copy it now."));
  openDialog(t("Link"), [
    isLoopback(share.url) && onlyHere(),
    !share.public && once,
    secret(t("Address"), share.url, "share-url"),
    secret(t("HTML code that embeds it in another page"), share.embed, "share-embed"),
    share.kml && secret(t("Live link for Google Earth and similar programs"), share.kml, "share-kml"),
  ].filter(Boolean));
}

/** A warning that an address of this computer is of no use elsewhere. */
export function onlyHere() {
  const chapter = h("a", { href: "/help/install#behind-nginx-with-tls", target: "_blank" }, t("Operating a server"));
  return h("div", { class: "note note--warning" }, icon("warning"),
    h("div", {},
      h("div", {}, t("This address works only on this computer.")),
      h("div", {}, t("On the same network: start the server with {command}, and open it at the address that it prints.", { command: "expmap serve --host 0.0.0.0" })),
      h("div", {}, t("On the internet:"), " ", chapter)));
}

/**
 * Checkboxes for what a share of a map, or of an answer, can include.
 * @param {{query: ?number, in3d: boolean}} what as for `linkForm`
 * @param {Object<string, boolean>} [given] what it includes already
 */
export function allowed({ query, in3d }, given = { photos: true }) {
  const may3d = in3d || given.landmarks;
  const hint3d = may3d ? t("Points in the colours of the photos, and where the placed photos were taken.") : t("This map has no landmarks yet: compute them on its 3D page.");
  const one = (name, label, hint = "", disabled = false) => box(name, label, { hint, disabled, checked: given[name] });
  return [
    one("photos", query === null ? t("Pictures of the photos") : t("The photo, and pictures of the map photos it matched")),
    query === null && one("localize", t("Visitors can localize their own photos"), t("They choose a photo, and see where on this map it was taken. Neither the photo nor the answer is stored.")),
    query === null && one("contribute", t("Visitors can give photos"), t("They agree that you keep, show and share them. Each photo waits until you accept or refuse it.")),
    query === null && one("notes", t("Notes on photos and on the map")),
    query === null && one("landmarks", t("The map in 3D"), hint3d, !may3d),
    one("originals", t("Originals"), t("With names, times, GPS and everything else that a camera writes into them.")),
  ].filter(Boolean);
}

/** @param {string} name @param {string} label @param {{hint?: string, disabled?: boolean, checked?: boolean}} more */
function box(name, label, { hint = "", ...more }) {
  return h("label", { class: "check share-way" },
    h("input", { type: "checkbox", name, ...more }),
    h("span", {}, label, hint && h("span", { class: "field__hint share-way__hint" }, hint)));
}

/** @param {HTMLElement} root of checkboxes @returns {Object<string, boolean>} state by name */
export function checked(root) {
  return Object.fromEntries(queryAll("input[type=checkbox]", HTMLInputElement, root).map((one) => [one.name, one.checked]));
}

/** A read-only text with a button that copies it. @param {string} label @param {string} value @param {string} id */
export function secret(label, value, id) {
  const input = h("input", { class: "input", id, value, readonly: true, "data-testid": id });
  const word = h("span", {}, t("Copy"));
  const copy = async () => {
    input.select();
    // Without https there is no clipboard for scripts: the selected text can be copied by hand.
    if (!navigator.clipboard) return;
    await navigator.clipboard.writeText(value);
    word.textContent = t("Copied");
  };
  return h("div", { class: "field" },
    h("label", { for: id }, label),
    h("div", { class: "secret" }, input, h("button", { class: "button", type: "button", onclick: copy }, icon("copy"), word)));
}

/** Text with the author of a share, which stays open when the author's account is removed. @param {{maker: ?string}} share */
export function maker(share) {
  return share.maker === null ? t("made by an account that was removed") : t("made by {name}", { name: share.maker });
}
