/** The dialog that suggests places for the photos in the tray from the placed ones. */

import { errorLine, openDialog } from "../shared/dialogs.js";
import { byId, h, icon } from "../shared/dom.js";
import { accuracyText, leftText, offText } from "../shared/format.js";
import { labelled, t, tn } from "../shared/i18n.js";
import { toast, toastError } from "../shared/toast.js";
import { nameList } from "./name-list.js";
import { offer, placeButton, placeOnClick } from "./place-button.js";

const SHOWN = 200;

/** Default limit for placing all at once: this many times the median radius. */
const UNCERTAIN = 4;

/** @param {Object} page store, server, refresh, dots and view @returns {HTMLDialogElement} */
function restDialog({ store, server, refresh, dots, view }) {
  const outcome = h("div", { class: "stack stack--tight", "aria-live": "polite", "data-testid": "rest-outcome" });
  const error = errorLine();
  const place = placeButton({ "data-testid": "rest-place" });
  const within = h("input", { class: "input ed-rest__within", type: "number", min: 0, step: "any", inputmode: "decimal", "data-testid": "rest-within" });
  const limit = h("label", { class: "row", hidden: true }, t("Place those that are certain within"), within, unit(store) === 1 ? t("pixels") : t("metres"));
  const find = h("button", { class: "button", type: "button", "data-testid": "rest-find" }, t("Suggest places"));
  const dialog = openDialog(t("Place the rest"), [
    h("p", { class: "soft" }, t("Place a few photos by hand, far apart. The others are then placed by what the photos have in common.")),
    limit,
    outcome,
    error,
  ], { actions: [find, place], modeless: true });

  const bar = h("progress", { class: "progress", max: 1, "aria-label": t("Suggest places") });
  const left = h("span", { class: "soft" });
  let job = null;
  let suggested = [];
  let ids = [];
  const choose = () => {
    const most = within.valueAsNumber / unit(store);
    ids = suggested.filter(({ radius_px: radius }) => !(radius > most)).map(({ id }) => id);
    offer(place, ids.length);
  };
  const show = (rest) => {
    job = rest.job;
    find.disabled = job !== null;
    suggested = rest.suggested.toSorted((a, b) => b.radius_px - a.radius_px);
    limit.hidden = !suggested.length;
    if (!within.value && suggested.length) within.value = limitOf(suggested, unit(store));
    choose();
    dots.setSuggestions([...rest.suggested, ...rest.corrected]);
    outcome.replaceChildren(...[
      job !== null && h("p", {}, t("This is being computed; it takes a few minutes."), " ", left),
      job !== null && bar,
      job === null && rest.revision !== null && (suggested.length > 0 || !rest.corrected.length) && summary(rest),
      suggested.length > 0 && h("ul", { class: "small ed-rest" }, ...suggested.slice(0, SHOWN).map(row)),
      nameList(t("Stays in the tray"), rest.left.map(({ name, reason }) => labelled(name, reason))),
      nameList(t("Contradicts the other placed photos"), rest.doubtful.map(({ name, residual_px: away }) =>
        t("{name}: they put it {distance} away", { name, distance: length(away) }))),
      rest.corrected.length > 0 && corrections(rest.corrected),
      rest.place_next.length > 0 && h("p", { class: "row" }, t("Placing these by hand helps most:"), ...rest.place_next.map(chooser)),
    ].filter(Boolean));
  };
  const length = (pixels) => offText(pixels, store.georeference.metresPerPixel);
  const row = (one) => h("li", { "data-testid": "suggested-photo", "data-id": one.id },
    h("button", { class: "button button--quiet", type: "button", onclick: () => view.focus([[one.x_px, one.y_px]]) }, one.name),
    h("span", { class: "soft" }, t("within {distance}", { distance: length(one.radius_px) })),
    h("button", { class: "button button--quiet", type: "button", "aria-label": t("Place {name}", { name: one.name }), onclick: () => accept([one.id]) }, t("Place")));
  const corrections = (corrected) => {
    const mean = corrected.reduce((sum, { moved_m: metres }) => sum + metres, 0) / corrected.length;
    const move = h("button", { class: "button", type: "button", "data-testid": "rest-correct", onclick: () => correct(corrected.map(({ id }) => id)) }, t("Move them"));
    return h("p", { class: "row" }, tn(
      "{n} photo placed by GPS is {distance} from where all photos together put it.",
      "{n} photos placed by GPS are on average {distance} from where all photos together put them.",
      corrected.length, { distance: accuracyText(mean) }), move);
  };
  const correct = async (chosen) => {
    try {
      const { placed } = await server.correctRest(chosen);
      await refresh();
      toast(tn("{n} photo moved.", "{n} photos moved.", placed.length));
      await look(server.rest);
    } catch (problem) {
      error.show(problem);
    }
  };
  const chooser = (id) => h("button", { class: "button button--quiet", type: "button", onclick: () => store.setCurrent(id) },
    store.photos.get(id)?.name ?? String(id));
  const look = async (question) => {
    try {
      error.show(null);
      show(await question());
    } catch (problem) {
      error.show(problem);
    }
  };
  const accept = async (chosen) => {
    try {
      const result = await server.acceptRest(chosen);
      await refresh();
      toast(tn("{n} photo placed.", "{n} photos placed.", result.placed.length));
      await look(server.rest);
    } catch (problem) {
      error.show(problem);
    }
  };
  const watch = () => {
    const known = store.jobs.find(({ id }) => id === job);
    if (!known || known.state === "queued" || known.state === "running") {
      if (known?.total) bar.value = known.done / known.total;
      left.textContent = known && known.seconds_left !== null ? leftText(known.seconds_left) : "";
      return;
    }
    job = null;
    look(server.rest).then(() => {
      if (known.state === "failed") error.show(known.error);
      else if (suggested.length) view.focus(dots.suggestions.map(({ x_px: x, y_px: y }) => [x, y]));
    });
  };
  store.addEventListener("jobs", watch);
  within.addEventListener("input", choose);
  find.addEventListener("click", () => look(server.findRest).then(refresh));
  placeOnClick(place, {
    place: () => server.acceptRest(ids),
    done: async (result) => {
      dialog.close();
      await refresh();
      toast(tn("{n} photo placed.", "{n} photos placed.", result.placed.length));
    },
    error,
  });
  dialog.addEventListener("close", () => {
    store.removeEventListener("jobs", watch);
    job = null;
    dots.setSuggestions([]);
  });
  look(server.rest);
  return dialog;
}

/**
 * Connect the bar above the tray that leads to suggestions, also those of jobs that ended earlier.
 * @param {Object} page store, server, refresh, dots and view
 * @returns {function(): void} opens the dialog, unless it is open
 */
export function connectRest(page) {
  const { store, server } = page;
  const bar = byId("rest-bar");
  const text = h("span", { class: "grow" });
  let suggested = [];
  let seen = null;
  let dialog = null;
  const show = () => {
    const left = suggested.filter(({ id }) => store.photos.has(id) && !store.isPlaced(id)).length;
    bar.hidden = dialog !== null || !left;
    text.textContent = tn("{n} photo has a suggested place.", "{n} photos have a suggested place.", left);
  };
  const ask = async () => {
    ({ suggested } = await server.rest());
    show();
  };
  const open = () => {
    if (dialog) return;
    dialog = restDialog(page);
    dialog.addEventListener("close", () => {
      dialog = null;
      ask().catch(toastError);
    });
    show();
  };
  bar.append(icon("pin"), text, h("button", { class: "button", type: "button", "data-testid": "rest-look", onclick: open }, t("Look at them")));
  store.on("photos", show);
  store.on("jobs", () => {
    const done = store.jobs.findLast(({ kind, state }) => kind === "place-rest" && state === "done");
    if (!done || done.id === seen) return;
    seen = done.id;
    ask().catch(toastError);
  });
  if (store.unplaced().length) ask().catch(toastError);
  return open;
}

/** Metres of a pixel; 1 on a map without a georeference. */
function unit(store) {
  return store.georeference.metresPerPixel || 1;
}

/** Default limit of the radius for placing, rounded up. */
function limitOf(suggested, metresPerPixel) {
  const most = UNCERTAIN * suggested[Math.floor(suggested.length / 2)].radius_px * metresPerPixel;
  return String(most < 10 ? Math.ceil(most * 10) / 10 : Math.ceil(most));
}

/** Number of suggestions, and whether the map has changed since. */
function summary({ suggested, current }) {
  const found = tn("{n} photo has a suggested place: see the hollow dots on the image.", "{n} photos have a suggested place: see the hollow dots on the image.", suggested.length);
  return h("p", {}, found, current ? "" : ` ${t("The map has changed since.")}`);
}
