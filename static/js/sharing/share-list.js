/** The share links of a map, on its settings page. */

import { del, get, patch } from "../shared/api.js";
import { confirmDialog, errorLine, openDialog } from "../shared/dialogs.js";
import { h, icon } from "../shared/dom.js";
import { moment, t } from "../shared/i18n.js";
import { allowed, checked, maker, shareDialog, showAddress } from "../shared/share-dialog.js";
import { toastError } from "../shared/toast.js";

const list = document.getElementById("shares");
const { slug } = list.dataset;
const in3d = "in3d" in list.dataset;
const base = `/maps/${encodeURIComponent(slug)}/shares`;

document.getElementById("share-new").addEventListener("click", () => shareDialog({ slug, in3d, made: show }));
show();

async function show() {
  try {
    const { shares } = await get(base);
    list.replaceChildren(...shares.map(entry));
    document.getElementById("shares-none").hidden = shares.length > 0;
  } catch (error) {
    toastError(error);
  }
}

function entry(share) {
  const what = share.query === null ? t("The map") : t("One answer");
  return h("li", { class: "share", "data-testid": "share", dataset: { id: share.id } },
    h("div", { class: "share__text" },
      h("div", {}, what, " ", h("span", { class: share.public ? "badge badge--accent" : "badge" }, share.public ? t("public") : t("by a secret link"))),
      h("div", { class: "small soft" }, [...gives(share), maker(share), moment(share.created_at)].join(" · "))),
    share.query !== null && h("a", { class: "icon-button", href: `/maps/${slug}/localize?query=${share.query}`, "aria-label": t("Show the answer") }, icon("search")),
    share.url && button("link", t("Show the link"), () => showAddress(share)),
    button("pencil", t("What is shared"), () => change(share)),
    button("close", t("Revoke the link"), () => revoke(share)));
}

function gives(share) {
  return [
    share.photos && t("pictures"),
    share.localize && t("visitors can localize"),
    share.notes && t("notes"),
    share.landmarks && t("in 3D"),
    share.originals && t("originals"),
  ].filter(Boolean);
}

function button(symbol, label, run) {
  return h("button", { class: "icon-button", type: "button", "aria-label": label, title: label, onclick: run }, icon(symbol));
}

function change(share) {
  const boxes = h("div", { class: "share-ways" }, ...allowed({ query: share.query, in3d }, share));
  const error = errorLine();
  const save = h("button", { class: "button button--primary", type: "button" }, t("Save"));
  const dialog = openDialog(t("What is shared"), [boxes, error], { actions: [save] });
  save.addEventListener("click", async () => {
    try {
      await patch(`${base}/${share.id}`, checked(boxes));
      dialog.close();
      show();
    } catch (problem) {
      error.show(problem);
    }
  });
}

async function revoke(share) {
  const text = t("The link and its embeds stop working at once.");
  if (!(await confirmDialog({ title: t("Revoke the link?"), text, action: t("Revoke it"), danger: true }))) return;
  try {
    await del(`${base}/${share.id}`);
  } catch (error) {
    toastError(error);
  }
  show();
}
