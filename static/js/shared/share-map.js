/** The dialog *Share* of a map: the people who can see it, and its links. */

import { del, get, patch, post } from "./api.js";
import { busy, confirmDialog, errorLine, openDialog } from "./dialogs.js";
import { h, icon } from "./dom.js";
import { moment, t } from "./i18n.js";
import { allowed, checked, linkForm, maker, showAddress } from "./share-dialog.js";
import { toastError } from "./toast.js";

/** Connect the buttons that open the dialog; their `data-share` is the map. */
export function connectSharing() {
  for (const button of document.querySelectorAll("[data-share]")) {
    const { share: slug, people } = /** @type {HTMLElement} */ (button).dataset;
    button.addEventListener("click", () => busy(button, () => open(slug, people)).catch(toastError));
  }
}

/** @param {string} slug @param {string} [people] address of the page with the accounts, for those who may see it */
async function open(slug, people) {
  const base = `/maps/${encodeURIComponent(slug)}`;
  const [{ members }, { shares, in_3d: in3d }] = await Promise.all([get(`${base}/members`), get(`${base}/shares`)]);
  const links = new Links(`${base}/shares`, { slug, in3d });
  const dialog = openDialog(t("Share this map"), [
    h("div", { class: "share-parts" },
      h("section", { class: "stack stack--tight" }, ...new People(`${base}/members`, people).show(members)),
      h("section", { class: "stack stack--tight" }, ...links.show(shares))),
  ], { actions: [links.make], cancels: false });
  dialog.classList.add("dialog--wide");
}

/** Accounts with a role on the map. */
class People {
  constructor(base, people) {
    this.base = base;
    this.people = people;
    this.list = h("ul", { class: "shares" });
    this.error = errorLine();
  }

  show(members) {
    this._fill(members);
    const name = h("input", { class: "input grow", name: "name", required: true, maxlength: 60, autocomplete: "off", autocapitalize: "none", autofocus: matchMedia("(pointer: fine)").matches, placeholder: t("Name of an account"), "aria-label": t("Name of an account") });
    const role = roleSelect(t("Role"), "viewer");
    const add = h("button", { class: "button" }, icon("plus"), t("Add"));
    const form = h("form", { class: "row share-add" }, name, role, add);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      busy(add, async () => {
        if (await this._change(() => post(this.base, { name: name.value, role: role.value }))) name.value = "";
      });
    });
    const more = this.people && h("p", { class: "small soft" }, t("Not listed?"), " ", h("a", { href: this.people }, t("Create an account")));
    return [h("h3", {}, t("People with an account")), this.list, form, this.error, more].filter(Boolean);
  }

  _fill(members) {
    this.list.replaceChildren(...members.map((member) => this._entry(member)));
  }

  _entry({ account, name, role }) {
    const select = roleSelect(t("Role of {name}", { name }), role);
    select.addEventListener("change", async () => {
      if (!(await this._change(() => post(this.base, { name, role: select.value })))) select.value = role;
    });
    return h("li", { class: "share", "data-testid": "member" },
      h("div", { class: "share__text" }, name), select,
      iconButton("close", t("Stop sharing with {name}", { name }), () => this._change(() => del(`${this.base}/${account}`))));
  }

  /** @returns {Promise<boolean>} whether it was possible */
  async _change(request) {
    this.error.show(null);
    try {
      await request();
      this._fill((await get(this.base)).members);
      return true;
    } catch (problem) {
      this.error.show(problem);
      return false;
    }
  }
}

function roleSelect(label, value) {
  const roles = { viewer: t("can view"), editor: t("can edit"), owner: t("owner") };
  const select = h("select", { class: "select select--short", "aria-label": label },
    ...Object.entries(roles).map(([role, words]) => h("option", { value: role }, words)));
  return Object.assign(/** @type {HTMLSelectElement} */ (select), { value });
}

/** Links to the map and to its answers. */
class Links {
  constructor(base, { slug, in3d }) {
    this.base = base;
    this.slug = slug;
    this.in3d = in3d;
    this.list = h("ul", { class: "shares", id: "shares" });
    this.next = h("h4", {}, t("New link"));
    this.make = h("button", { class: "button button--primary", type: "button", "data-testid": "share-new" }, icon("link"), t("Create the link"));
    this.error = errorLine();
  }

  show(shares) {
    this._fill(shares);
    const { element, wish } = linkForm({ query: null, in3d: this.in3d });
    this.make.addEventListener("click", () => busy(this.make, () => this._make(wish())));
    return [
      h("h3", {}, t("Anyone with a link")),
      h("p", { class: "small soft" }, t("They see the map, and what you tick here, without an account.")),
      this.list, this.next, element, this.error,
      h("div", { class: "row" },
        h("a", { class: "button button--quiet", href: `/maps/${this.slug}/contributions` }, t("Photos from visitors")),
        h("a", { class: "button button--quiet", href: "/public" }, t("Public maps"))),
    ];
  }

  async _make(wish) {
    this.error.show(null);
    try {
      showAddress(await post(this.base, wish));
      await this._refresh();
    } catch (problem) {
      this.error.show(problem);
      this.error.scrollIntoView({ block: "nearest" });
    }
  }

  async _refresh() {
    this._fill((await get(this.base)).shares);
  }

  _fill(shares) {
    this.next.hidden = !shares.length;
    this.list.replaceChildren(...shares.map((share) => this._entry(share)));
  }

  _entry(share) {
    const what = share.query === null ? t("The map") : t("One answer");
    return h("li", { class: "share", "data-testid": "share", dataset: { id: share.id } },
      h("div", { class: "share__text" },
        h("div", {}, what, " ", h("span", { class: share.public ? "badge badge--accent" : "badge" }, share.public ? t("public") : t("by a secret link"))),
        h("div", { class: "small soft" }, [...gives(share), maker(share), moment(share.created_at)].join(" · "))),
      share.query !== null && h("a", { class: "icon-button", href: `/maps/${this.slug}/localize?query=${share.query}`, "aria-label": t("Show the answer") }, icon("search")),
      share.url && iconButton("link", t("Show the link"), () => showAddress(share)),
      iconButton("pencil", t("What is shared"), () => this._edit(share)),
      iconButton("close", t("Revoke the link"), () => this._revoke(share)));
  }

  _edit(share) {
    const boxes = h("div", { class: "share-ways" }, ...allowed({ query: share.query, in3d: this.in3d }, share));
    const error = errorLine();
    const save = h("button", { class: "button button--primary", type: "button" }, t("Save"));
    const dialog = openDialog(t("What is shared"), [boxes, error], { actions: [save] });
    save.addEventListener("click", async () => {
      try {
        await patch(`${this.base}/${share.id}`, checked(boxes));
        dialog.close();
        await this._refresh();
      } catch (problem) {
        error.show(problem);
      }
    });
  }

  async _revoke(share) {
    const text = t("The link and its embeds stop working at once.");
    if (!(await confirmDialog({ title: t("Revoke the link?"), text, action: t("Revoke it"), danger: true }))) return;
    try {
      await del(`${this.base}/${share.id}`);
      await this._refresh();
    } catch (problem) {
      this.error.show(problem);
    }
  }
}

function gives(share) {
  return [
    share.photos && t("pictures"),
    share.localize && t("visitors can localize"),
    share.contribute && t("visitors can give photos"),
    share.notes && t("notes"),
    share.landmarks && t("in 3D"),
    share.originals && t("originals"),
  ].filter(Boolean);
}

function iconButton(symbol, label, run) {
  return h("button", { class: "icon-button", type: "button", "aria-label": label, title: label, onclick: run }, icon(symbol));
}
