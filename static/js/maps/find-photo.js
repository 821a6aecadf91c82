/** "Which map is this?": a dialog that searches for a photo on all maps. */

import { ACCEPTED } from "../shared/accepted.js";
import { WaitingWords } from "../shared/answer/waiting-words.js";
import { upload } from "../shared/api.js";
import { busy, errorLine, openDialog } from "../shared/dialogs.js";
import { h, icon } from "../shared/dom.js";
import { usable } from "../shared/drop-files.js";
import { labelled, locale, t, tn } from "../shared/i18n.js";

const LIKELY = 0.5;
const SHOWN = 5;

/** Open the dialog. */
export function findPhoto() {
  const input = h("input", { type: "file", accept: ACCEPTED.photos, hidden: true, "aria-label": t("Photo"), "data-testid": "find-input" });
  const choose = h("button", { class: "button button--primary", type: "button", onclick: () => input.click() }, icon("image"), t("Choose a photo"));
  const results = h("div", { class: "stack", role: "status", "data-testid": "find-results" });
  const error = errorLine();
  const about = h("p", { class: "soft" }, t("Searches all your maps that have an index. The photo is not kept."));
  const dialog = openDialog(t("Which map is this?"), [about, h("div", { class: "row" }, choose, input), error, results]);
  const take = (files) => files.length && busy(choose, () => search(files[0], results, error));
  input.addEventListener("change", () => {
    const files = usable(input.files);
    input.value = "";
    take(files);
  });
  dialog.addEventListener("dragover", (event) => event.preventDefault());
  dialog.addEventListener("drop", (event) => {
    event.preventDefault();
    take(usable(event.dataTransfer.files));
  });
}

async function search(file, results, error) {
  error.show(null);
  const image = h("img", { class: "find-photo", src: URL.createObjectURL(file), alt: file.name });
  const picture = h("div", {}, image);
  // format unknown to this browser
  image.addEventListener("error", () => picture.replaceChildren(h("p", { class: "small soft" }, t("This photo cannot be shown."))));
  const bar = /** @type {HTMLProgressElement} */ (h("progress", { class: "progress", "aria-label": t("Searching the maps") }));
  const said = h("p", { class: "small soft" });
  const words = new WaitingWords(said, bar);
  results.replaceChildren(picture, bar, said);
  words.begin(true);
  try {
    const found = await upload("/find", {
      body: form(file), onProgress: (sent, all) => words.sent(sent, all), onEvent: (kind, data) => words.take(kind, data),
    });
    results.replaceChildren(picture, verdict(found), list(found, file, error), ...notSearched(found));
  } catch (problem) {
    results.replaceChildren(picture);
    error.show(problem);
  }
  words.end();
}

function form(file) {
  const body = new FormData();
  body.append("file", file);
  return body;
}

function verdict({ maps, no_map_probability: none, not_searched: skipped, less_alike: further }) {
  const [best] = maps;
  const nowhere = skipped.length || further ? t("Probably on none of the maps that were searched") : t("Probably on none of your maps");
  const words = !best ? t("None of your maps can be searched yet.")
    : best.probability >= LIKELY ? t("On the map {name}", { name: best.name })
      : none >= LIKELY ? nowhere : t("Uncertain");
  return h("h3", { "data-testid": "find-verdict" }, words);
}

/** The most probable maps, each with a button, and the probability of none. */
function list({ maps, no_map_probability: none }, file, error) {
  const rows = maps.slice(0, SHOWN).map(({ slug, name, probability }) => {
    const show = h("button", { class: "button", type: "button", "aria-label": t("Show on {name}", { name }) }, t("Show"));
    show.addEventListener("click", () => busy(show, () => open(slug, file)).catch((problem) => error.show(problem)));
    return row(name, probability, show);
  });
  const rest = maps.slice(SHOWN).reduce((sum, { probability }) => sum + probability, 0);
  if (maps.length > SHOWN) rows.push(row(tn("{n} more map", "{n} more maps", maps.length - SHOWN), rest));
  if (maps.length) rows.push(row(t("None of these maps"), none));
  return h("ul", { class: "find-maps" }, ...rows);
}

function row(name, probability, button = null) {
  const text = Math.min(Math.max(probability, 0.01), 0.99).toLocaleString(locale, { style: "percent" });
  const percent = probability < 0.01 ? `< ${text}` : probability > 0.99 ? `> ${text}` : text;
  return h("li", {},
    h("span", { class: "find-maps__name" }, name),
    h("meter", { min: 0, max: 1, value: probability, "aria-label": labelled(name, percent) }),
    h("span", { class: "number" }, percent),
    button);
}

function notSearched({ not_searched: skipped, less_alike: further }) {
  const rest = further ? [h("p", { class: "small" }, tn(
    "{n} more map, with less similar photos, was not searched",
    "{n} more maps, with less similar photos, were not searched", further))] : [];
  if (!skipped.length) return rest;
  return [...rest, h("details", { class: "small" },
    h("summary", {}, tn("{n} map was not searched", "{n} maps were not searched", skipped.length)),
    h("ul", {}, ...skipped.map(({ name, reason, hint }) => h("li", {}, labelled(name, [reason, hint].filter(Boolean).join("; "))))))];
}

/** Localize the photo on a map, which stores it in the history, and open the answer. */
async function open(slug, file) {
  const { id } = await upload(`/maps/${slug}/localize`, { body: form(file) });
  location.assign(`/maps/${slug}/localize?query=${id}`);
}
