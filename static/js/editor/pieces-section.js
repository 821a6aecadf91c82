/** The part of the dialog for the next photos that checks which photos join, and between which some are missing. */

import { errorLine } from "../shared/dialogs.js";
import { h } from "../shared/dom.js";
import { t, tn } from "../shared/i18n.js";

const SHOWN = 100;

/**
 * @param {Object} page store, server and refresh
 * @returns {{box: HTMLElement, close: function(): void}}
 */
export function piecesSection({ store, server, refresh }) {
  const error = errorLine();
  const outcome = h("div", { class: "stack stack--tight small", "aria-live": "polite", "data-testid": "pieces-outcome" });
  const check = h("button", { class: "button", type: "button", "data-testid": "pieces-check" }, t("Check which photos join"));
  let job = null;

  const photo = (id) => h("button", { class: "button button--quiet", type: "button", onclick: () => store.setCurrent(id) },
    store.photos.get(id)?.name ?? String(id));
  const gapRow = ({ photo: one, other, matches }) => h("li", { class: "row", "data-testid": "pieces-gap" },
    photo(one), "–", photo(other),
    h("span", { class: "soft" }, matches ? tn("{n} point in common", "{n} points in common", matches) : t("nothing in common")));
  const listed = (title, rows) => [h("h3", {}, title), h("ul", { class: "ed-rest" }, ...rows.slice(0, SHOWN))];
  const show = (found) => {
    job = found.job;
    check.disabled = job !== null;
    const { pieces, alone, bridges, gaps, place_next: first } = found;
    outcome.replaceChildren(...[
      job !== null && h("p", {}, t("This is being computed; it takes some seconds.")),
      ...(found.revision === null ? [] : [
        h("p", {}, h("strong", {}, summary(pieces)), " ",
          alone.length > 0 && tn("{n} photo joins with no other.", "{n} photos join with no other.", alone.length),
          found.current ? "" : ` ${t("The map has changed since.")}`),
        ...(gaps.length ? listed(t("Take photos between these"), gaps.map(gapRow)) : []),
        bridges.length > 0 && h("p", { class: "row" }, t("A few more photos next to these connect pieces:"), ...bridges.slice(0, SHOWN).map(photo)),
        first.length > 0 && h("p", { class: "row" }, t("Place these first:"), ...first.slice(0, SHOWN).map(photo)),
      ]),
    ].filter(Boolean));
  };
  const look = async (question) => {
    try {
      error.show(null);
      show(await question());
    } catch (problem) {
      error.show(problem);
    }
  };
  const watch = () => {
    const known = store.jobs.find(({ id }) => id === job);
    if (job === null || !known || known.state === "queued" || known.state === "running") return;
    job = null;
    look(server.pieces).then(() => known.state === "failed" && error.show(known.error));
  };
  store.addEventListener("jobs", watch);
  check.addEventListener("click", () => look(server.checkPieces).then(refresh));
  look(server.pieces);
  const box = h("section", { class: "stack stack--tight", "aria-label": t("Which photos join") },
    h("p", { class: "soft small" }, t("Photos place each other where they overlap. This takes seconds, before any is placed.")),
    h("p", { class: "row" }, check), outcome, error);
  return {
    box,
    close: () => {
      store.removeEventListener("jobs", watch);
      job = null;
    },
  };
}

function summary(pieces) {
  if (!pieces.length) return t("No photos join.");
  const sizes = pieces.map((piece) => piece.length);
  return tn("{n} piece, of {sizes} photos.", "{n} pieces, of {sizes} photos.", pieces.length, { sizes: sizes.join(", ") });
}
