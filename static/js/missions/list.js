/** The list of missions: search, create, import files, rename, delete. */

import { askDialog, busy, confirmDialog, errorLine, field, openDialog } from "../shared/dialogs.js";
import { byId, h, icon, queryAll, svg, targetOf } from "../shared/dom.js";
import { listenToDrops, usable } from "../shared/drop-files.js";
import { moment, t, tn } from "../shared/i18n.js";
import { byName, largest, ListTools } from "../shared/list-tools.js";
import { sentence, toastError } from "../shared/toast.js";
import { endpointsOf, makeMission, mapImage, missionList } from "./endpoints.js";
import { lengthText, recordedText, spanText } from "./format.js";
import { coveringMap, titleOf } from "./import/proposals.js";
import { startFields } from "./import/start-fields.js";
import { StartPose } from "./import/start-pose.js";
import { importDialog } from "./import/wizard.js";

/** @type {{maps: Array<{slug: string, name: string, box: ?import("./import/proposals.js").Box}>, binned: boolean}} */
const { maps, binned } = JSON.parse(byId("page").textContent);
const list = byId("missions");
const PAGE = 50;
let follow = null; // cursor of the next page
let searched = ""; // text that the server has searched for, or empty
let asked = 0; // number of requests, to discard responses to outdated ones
const tools = binned ? null : new ListTools(list, {
  kept: "expmap.missions-sort",
  orders: { name: byName, length: largest("length") },
  bin: (id) => endpointsOf(Number(id)).bin(),
  restore: (id) => endpointsOf(Number(id)).restore(),
  binned: (n) => tn("{n} mission is in the bin.", "{n} missions are in the bin.", n),
  search: (text) => load({ limit: PAGE, search: text }),
  whole: () => load({ limit: null }),
});

for (const button of queryAll("[data-opens=create]", HTMLButtonElement)) ready(button, create);
for (const button of queryAll("[data-opens=import]", HTMLButtonElement)) ready(button, () => importFiles([]));
if (!binned) listenToDrops(byId("drop"), (files) => files.length && importFiles(usable(files)));
byId("try-again").addEventListener("click", show);
byId("more").addEventListener("click", (event) => busy(event.currentTarget, showMore).catch(toastError));
show();

function ready(button, run) {
  button.addEventListener("click", run);
  button.disabled = false; // disabled until this listener is attached
}

async function show() {
  byId("failed").hidden = true;
  byId("loading").hidden = false;
  try {
    await load({ limit: Math.max(PAGE, list.children.length), search: searched });
  } catch (error) {
    byId("failed").hidden = false;
    byId("failed-text").textContent = [error.message, error.hint].filter(Boolean).map(sentence).join(". ");
  }
  byId("loading").hidden = true;
}

async function load({ limit, search = "" }) {
  asked += 1;
  const question = asked;
  const { missions, next } = await missionList({ binned, search, limit, previews: true });
  if (question !== asked) return;
  searched = search;
  list.replaceChildren(...missions.map(card));
  byId("empty").hidden = missions.length > 0 || search !== "";
  // an empty page has one main button: import
  for (const button of queryAll("[data-opens=create]")) button.classList.toggle("button--primary", byId("empty").hidden);
  if (tools) byId("list-tools").hidden = missions.length < 2 && search === "";
  goOnAt(next);
}

async function showMore() {
  const question = asked;
  const { missions, next } = await missionList({ binned, search: searched, after: follow, limit: PAGE, previews: true });
  if (question !== asked) return;
  const cards = missions.map(card);
  list.append(...cards);
  goOnAt(next);
  cards[0]?.querySelector("a, button")?.focus();
}

function goOnAt(next) {
  follow = next;
  byId("more").hidden = next === null;
  tools?.refresh({ whole: next === null, searched });
}

function card(mission) {
  const { id, name, map, poses, objects, photos, distance_m: way, duration_s: duration, ended_at: ended } = mission;
  const facts = [
    way ? lengthText(way) : null,
    duration ? spanText(duration) : null,
    tn("{n} position", "{n} positions", poses),
    objects ? tn("{n} object", "{n} objects", objects) : null,
    photos ? tn("{n} photo", "{n} photos", photos) : null,
  ].filter(Boolean);
  const onMap = maps.find(({ slug }) => slug === map)?.name;
  const title = binned ? h("span", {}, name) : h("a", { class: "map-card__link", href: `/missions/${id}` }, name);
  const owned = mission.role === "owner";
  const data = { key: id, name, search: `${name} ${onMap ?? ""}`, length: way, file: endpointsOf(id).file("export.kmz") };
  return h("li", { class: "card map-card", "data-testid": "mission", dataset: data },
    !binned && owned && h("label", { class: "map-card__pick" }, h("input", { type: "checkbox", "data-pick": true, "aria-label": t("Select {name}", { name }) })),
    picture(mission),
    h("div", { class: "map-card__text" },
      h("div", { class: "map-card__title" },
        h("h2", {}, title),
        h("span", { class: "small soft number" }, facts.join(" · ")),
        h("span", { class: "small soft" }, [whenText(mission), onMap && t("on {map}", { map: onMap })].filter(Boolean).join(" · "),
          !binned && ended && h("span", { class: "badge mi-ended" }, t("Ended"))),
        owned && binned && binButtons(mission)),
      owned && !binned && menu(mission)));
}

/** When it was recorded, or else when it last changed. */
function whenText({ first_time_s: first, last_time_s: last, changed_at: changed }) {
  if (first === null || first === undefined) return t("changed {time}", { time: moment(changed) });
  return recordedText(first, last);
}

/** Thumbnail of the track and objects, on the image of the map if they are on it. */
function picture({ preview }) {
  if (!preview) return h("div", { class: "map-card__picture" }, icon("route"));
  const twice = (name, path) => (path ? [svg("path", { class: name, d: path }), svg("path", { class: name, d: path })] : []);
  const drawn = svg("svg", { class: "map-card__dots", "aria-hidden": "true", viewBox: `0 0 ${preview.width} ${preview.height}`, preserveAspectRatio: "xMidYMid meet" },
    ...twice("map-card__line", preview.line), ...twice("map-card__found", preview.dots));
  const image = preview.image && h("img", { src: preview.image, alt: "", loading: "lazy", width: 480, height: 300 });
  return h("div", { class: "map-card__picture" }, image, drawn);
}

function binButtons({ id, name }) {
  const server = endpointsOf(id);
  const restore = (event) => busy(event.currentTarget, () => server.restore().then(show)).catch(toastError);
  const remove = async () => {
    const title = t("Delete {name} permanently?", { name });
    const text = t("Its tracks, objects and photos are deleted from the disk. This cannot be undone.");
    if (!(await confirmDialog({ title, text, action: t("Delete permanently"), danger: true }))) return;
    await server.deleteForever().then(show).catch(toastError);
  };
  return h("div", { class: "row" },
    h("button", { class: "button", type: "button", onclick: restore }, icon("back"), t("Restore")),
    h("button", { class: "icon-button", type: "button", "aria-label": t("Delete {name} permanently", { name }), onclick: remove }, icon("trash")));
}

function menu({ id, name }) {
  const server = endpointsOf(id);
  const pick = (run) => (event) => {
    event.currentTarget.closest("details").open = false;
    run().catch(toastError);
  };
  const rename = async () => askDialog({ title: t("Rename the mission"), label: t("Name"), value: name, action: t("Rename") }, async (wanted) => {
    await server.change({ name: wanted });
    await show();
  });
  const bin = () => tools.toBin(tools.cards.filter(({ dataset }) => dataset.key === String(id)));
  return h("details", { class: "menu" },
    h("summary", { class: "icon-button", "aria-label": t("Actions for {name}", { name }) }, icon("more")),
    h("div", { class: "menu__list" },
      h("button", { class: "menu__item", type: "button", onclick: pick(rename) }, icon("pencil"), t("Rename")),
      h("a", { class: "menu__item", href: server.file("export.kmz") }, icon("download"), t("Download as KMZ")),
      h("hr"),
      h("button", { class: "menu__item menu__item--danger", type: "button", onclick: pick(bin) }, icon("trash"), t("Move to the bin"))));
}

function mapField() {
  const select = h("select", { class: "select" },
    h("option", { value: "" }, t("none: anywhere on Earth")), ...maps.map(({ slug, name }) => h("option", { value: slug }, name)));
  return { select, field: field(t("Map"), select, t("Everyone who can see the map can see the mission, and its photos can be localized.")) };
}

function create() {
  const name = h("input", { class: "input", required: true, maxlength: 120, autocomplete: "off", "data-testid": "mission-name" });
  const { select, field: map } = mapField();
  const begin = new StartPose();
  const error = errorLine();
  const start = h("details", {}, h("summary", {}, t("Start position of the robot")), h("div", { class: "stack stack--tight" },
    h("p", { class: "soft small" }, t("For robots that report positions in their own frame: its origin, and the direction of its x axis, clockwise from north.")),
    startFields(begin, { titled: false })));
  const make = h("button", { class: "button button--primary", type: "button" }, t("Create"));
  const dialog = openDialog(t("New mission"), [field(t("Name"), name), map, start, error], { actions: [make] });
  const run = async () => {
    error.show(null);
    if (begin.problem) return error.show({ message: begin.problem });
    try {
      const { id } = await makeMission({ name: name.value, map: select.value || null, start: begin.whole, note: "" });
      location.assign(`/missions/${id}`);
    } catch (problem) {
      error.show(problem);
    }
    return null;
  };
  make.addEventListener("click", () => busy(make, run));
  dialog.addEventListener("keydown", (event) => {
    if (event.key === "Enter" && targetOf(event).matches("input")) busy(make, run);
  });
  name.focus();
}

function importFiles(files) {
  const { select, field: map } = mapField();
  const name = h("input", { class: "input", maxlength: 120, autocomplete: "off", "data-testid": "import-name" });
  let chosen = false;
  select.addEventListener("change", ({ isTrusted }) => (chosen ||= isTrusted));
  importDialog({
    files,
    into: {
      fields: [h("div", { class: "stack im-mission" }, field(t("Name of the mission"), name, t("Default: the name in the file, or else that of the file.")), map)],
      wish: (file) => ({ new_mission: { name: name.value.trim() || titleOf(file), map: select.value || null } }),
      propose: (found) => {
        name.placeholder = titleOf(found[0]);
        const slug = coveringMap(maps, found.flatMap(({ wanted }) => wanted))?.slug ?? "";
        if (chosen || select.value === slug) return;
        select.value = slug;
        select.dispatchEvent(new Event("change"));
      },
      look: async () => ({ place: { satellite: select.value ? await mapImage(select.value) : null, lines: [] }, start: null }),
      onChange: (run) => select.addEventListener("change", run),
    },
    done: (id) => location.assign(`/missions/${id}`),
  });
}
