/** The share links of a mission, which need no account to view it. */

import { busy, confirmDialog, errorLine, openDialog } from "../shared/dialogs.js";
import { h, icon } from "../shared/dom.js";
import { moment, t } from "../shared/i18n.js";
import { maker, showAddress } from "../shared/share-dialog.js";
import { toastError } from "../shared/toast.js";

/** @param {Object} server of the mission */
export async function sharesDialog(server) {
  try {
    const { shares } = await server.shares();
    open(server, shares);
  } catch (error) {
    toastError(error);
  }
}

function open(server, shares) {
  const open_to_all = h("input", { type: "checkbox", name: "public" });
  const photos = h("input", { type: "checkbox", name: "photos", checked: true });
  const error = errorLine();
  const make = h("button", { class: "button button--primary", type: "button" }, icon("link"), t("Create a link"));
  const list = h("ul", { class: "shares" }, ...shares.map((share) => entry(server, share, () => dialog.close())));
  const dialog = openDialog(t("Share this mission"), [
    shares.length ? list : h("p", { class: "soft" }, t("Anyone with a link sees the mission live, without signing in.")),
    h("div", { class: "share-ways" },
      h("label", { class: "check share-way" }, open_to_all, h("span", {}, t("Also list it under public missions"))),
      h("label", { class: "check share-way" }, photos, h("span", {}, t("With photos")))),
    error,
  ], { actions: [make] });
  make.addEventListener("click", () => busy(make, async () => {
    try {
      error.show(null);
      const share = await server.share({ public: open_to_all.checked, photos: photos.checked });
      dialog.close();
      showAddress(share);
    } catch (problem) {
      error.show(problem);
    }
  }));
}

function entry(server, share, close) {
  const show = () => (close(), showAddress(share));
  const revoke = async () => {
    close();
    const text = t("The link and its embeds stop working at once.");
    if (await confirmDialog({ title: t("Revoke the link?"), text, action: t("Revoke it"), danger: true })) {
      await server.revoke(share.id).catch(toastError);
    }
    sharesDialog(server);
  };
  return h("li", { class: "share", "data-testid": "share" },
    h("div", { class: "share__text" },
      h("span", { class: share.public ? "badge badge--accent" : "badge" }, share.public ? t("public") : t("by a secret link")),
      h("div", { class: "small soft" }, [maker(share), moment(share.created_at)].join(" · "))),
    share.url && h("button", { class: "icon-button", type: "button", "aria-label": t("Show the link"), onclick: show }, icon("link")),
    h("button", { class: "icon-button", type: "button", "aria-label": t("Revoke the link"), onclick: revoke }, icon("close")));
}
