/** The phones of a mission: who sends positions, and links for more of them. */

import { askDialog, confirmDialog, openDialog } from "../shared/dialogs.js";
import { h, icon, svg } from "../shared/dom.js";
import { isLoopback } from "../shared/format.js";
import { moment, t, tn } from "../shared/i18n.js";
import { onlyHere, secret } from "../shared/share-dialog.js";
import { toastError } from "../shared/toast.js";

/** @param {Object} server of the mission */
export async function phonesDialog(server) {
  try {
    const { phones } = await server.phones();
    open(server, phones);
  } catch (error) {
    toastError(error);
  }
}

function open(server, phones) {
  const add = h("button", { class: "button button--primary", type: "button", onclick: () => {
    dialog.close();
    askDialog({ title: t("Add a phone"), label: t("Who carries it?"), action: t("Create a link"), testid: "phone-name", maxlength: 60 },
      async (name) => showPhone(await server.addPhone(name)));
  } }, icon("plus"), t("Add a phone"));
  const about = t("A link for each person: the page behind it, or an app, sends the position of the phone. No account is needed.");
  const list = h("ul", { class: "shares" }, ...phones.map((phone) => entry(server, phone, () => dialog.close())));
  const dialog = openDialog(t("People with phones"), [h("p", { class: "soft" }, about), phones.length > 0 && list].filter(Boolean), { actions: [add] });
}

function entry(server, { id, name, heard_at: heard, positions }, close) {
  const remove = async () => {
    close();
    const text = t("The link stops working at once. The track stays.");
    if (await confirmDialog({ title: t("Remove {name}?", { name }), text, action: t("Remove"), danger: true })) {
      await server.removePhone(id).catch(toastError);
    }
    phonesDialog(server);
  };
  const sent = heard ? [t("last heard {when}", { when: moment(heard) }), tn("{n} position", "{n} positions", positions)].join(" · ") : t("has not sent anything yet");
  return h("li", { class: "share", "data-testid": "phone" },
    h("div", { class: "share__text" }, h("strong", {}, name), h("div", { class: "small soft" }, sent)),
    h("button", { class: "icon-button", type: "button", "aria-label": t("Remove {name}", { name }), onclick: remove }, icon("close")));
}

/** Show the addresses of a new phone, of which the server keeps only a hash. */
function showPhone({ name, url, qr, owntracks, owntracks_setup: setup, gpslogger }) {
  const side = String(qr.size);
  const code = svg("svg", { class: "qr", viewBox: `0 0 ${side} ${side}`, role: "img", "aria-label": t("QR code of the address"), "data-testid": "phone-qr" },
    svg("rect", { width: side, height: side, fill: "#fff" }), svg("path", { d: qr.path, fill: "#000" }));
  openDialog(name, [
    isLoopback(url) && onlyHere(),
    h("p", {}, t("Open this address on the phone, or scan it:")),
    code,
    secret(t("Address"), url, "phone-url"),
    h("details", {},
      h("summary", {}, t("With an app, also while the screen is off")),
      h("div", { class: "stack stack--tight" },
        secret(t("OwnTracks, mode HTTP"), owntracks, "phone-owntracks"),
        h("a", { href: setup }, t("Set OwnTracks up (open this on the phone)")),
        secret(t("GPSLogger, Traccar Client, OsmAnd"), gpslogger, "phone-gpslogger"))),
    h("p", { class: "small soft" }, t("These addresses are shown only once: copy them now.")),
  ].filter(Boolean));
}
