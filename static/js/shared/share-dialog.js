/** The dialog to share a map or one answer. */

import { post } from "./api.js";
import { busy, errorLine, openDialog } from "./dialogs.js";
import { h, icon, queryAll } from "./dom.js";
import { isLoopback } from "./format.js";
import { t } from "./i18n.js";

/**
 * Ask how to share, and show the new address.
 * @param {{slug: string, query?: ?number, in3d?: boolean, made?: function(Object): void}} what `query` is the id of an
 *   answer; `in3d` whether the map has landmarks; `made` is called with the new share
 */
export function shareDialog({ slug, query = null, in3d = false, made = () => {} }) {
  const ways = h(
    "fieldset",
    { class: "share-ways" },
    h("legend", { class: "visually-hidden" }, t("Who can see it")),
    way("secret", t("Anyone with the link"), t("Not listed anywhere; you can revoke it at any time."), true),
    way("public", t("Everyone"), t("Also listed under public maps; nobody has to sign in.")),
  );
  const allows = h("fieldset", { class: "share-ways" }, h("legend", { class: "visually-hidden" }, t("What is shared")), ...allowed({ query, in3d }));
  const error = errorLine();
  const send = h("button", { class: "button button--primary", type: "button" }, icon("link"), t("Create the link"));
  const body = [ways, allows, error];
  const dialog = openDialog(query === null ? t("Share this map") : t("Share this answer"), body, { actions: [send] });
  send.addEventListener("click", () => busy(send, async () => {
    try {
      error.show(null);
      const wish = { query, public: chosen(ways), ...checked(allows) };
      const share = await post(`/maps/${encodeURIComponent(slug)}/shares`, wish);
      dialog.close();
      made(share);
      showAddress(share);
    } catch (problem) {
      error.show(problem);
    }
  }));
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

function onlyHere() {
  const chapter = h("a", { href: "/help/operating#behind-nginx-with-tls", target: "_blank" }, t("Operating a server"));
  return h("div", { class: "note note--warning" }, icon("warning"),
    h("div", {}, t("This address works only on this computer. To share it with others:"), " ", chapter));
}

/**
 * Checkboxes for what a share of a map, or of an answer, can include.
 * @param {{query: ?number, in3d: boolean}} what as for `shareDialog`
 * @param {Object<string, boolean>} [given] what it includes already
 */
export function allowed({ query, in3d }, given = { photos: true }) {
  const box = (name, label, hint, disabled = false) =>
    h("label", { class: "check share-way" },
      h("input", { type: "checkbox", name, checked: given[name], disabled }),
      h("span", {}, label, hint && h("span", { class: "field__hint share-way__hint" }, hint)));
  const in3dBox = () => (in3d || given.landmarks
    ? box("landmarks", t("The map in 3D"), t("Points in the colours of the photos, and where the placed photos were taken."))
    : box("landmarks", t("The map in 3D"), t("This map has no landmarks yet: compute them on its 3D page."), true));
  return [
    box("photos", query === null ? t("Pictures of the photos") : t("The photo, and pictures of the map photos it matched")),
    query === null && box("notes", t("Notes on photos and on the map")),
    query === null && in3dBox(),
    query === null && box("localize", t("Visitors can localize their own photos")),
    box("originals", t("Originals"), t("With names, times, GPS and everything else that a camera writes into them.")),
  ].filter(Boolean);
}

/** @param {HTMLElement} root of checkboxes @returns {Object<string, boolean>} state by name */
export function checked(root) {
  return Object.fromEntries(queryAll("input[type=checkbox]", HTMLInputElement, root).map((box) => [box.name, box.checked]));
}

function chosen(ways) {
  return queryAll("input:checked", HTMLInputElement, ways)[0].value === "public";
}

function way(value, label, hint, first = false) {
  return h("label", { class: "check share-way" },
    h("input", { type: "radio", name: "share-way", value, checked: first }),
    h("span", {}, label, h("span", { class: "field__hint share-way__hint" }, hint)));
}

function secret(label, value, id) {
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
