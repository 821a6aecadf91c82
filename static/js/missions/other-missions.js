/** Other missions shown together with this one: chosen from a list, and kept in the address for links. */

import { openDialog } from "../shared/dialogs.js";
import { byId, h } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";
import { missionList } from "./endpoints.js";
import { Live } from "./live-events.js";

/**
 * @param {import("./mission-store.js").MissionStore} store
 * @param {function(): void} fit shows everything
 * @returns {function(number): void} removes a mission
 */
export function otherMissions(store, fit) {
  const following = new Map();
  const show = async (id) => {
    try {
      store.setMission(await store.server(id).state());
      if (!store.missions.get(id).ended_at) {
        following.set(id, new Live(store, id));
        following.get(id).start();
      }
      updateAddress(store);
      fit();
    } catch (error) {
      toastError(error);
    }
  };
  const forget = (id) => {
    following.get(id)?.stop();
    following.delete(id);
    store.removeMission(id);
    updateAddress(store);
    byId("add-mission").focus();
  };
  byId("add-mission").addEventListener("click", () => choose(store, show));
  for (const id of inAddress()) if (id !== store.id) show(id);
  return forget;
}

async function choose(store, show) {
  const list = h("ul", { class: "mi-choices" });
  const dialog = openDialog(t("Overlay another mission"), [list]);
  const entry = ({ id, name, poses }) => h("li", {}, h("button", {
    class: "menu__item", type: "button",
    onclick: () => {
      dialog.close();
      show(id);
    },
  }, h("span", { class: "grow" }, name), h("span", { class: "soft small number" }, tn("{n} position", "{n} positions", poses))));
  try {
    const { missions } = await missionList();
    const offered = missions.filter(({ id }) => !store.missions.has(id));
    list.replaceChildren(...offered.map(entry));
    if (!offered.length) list.replaceWith(h("p", { class: "soft" }, t("There is no other mission.")));
  } catch (error) {
    dialog.close();
    toastError(error);
  }
}

function inAddress() {
  const text = new URLSearchParams(location.search).get("with") || "";
  return [...new Set(text.split(",").map(Number).filter((id) => Number.isInteger(id) && id > 0))];
}

function updateAddress(store) {
  const others = [...store.missions.keys()].filter((id) => id !== store.id);
  history.replaceState(null, "", others.length ? `?with=${others.join(",")}` : location.pathname);
}
