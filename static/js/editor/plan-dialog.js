/** The dialog to plan the next photos: how well parts of the map are recognised, and a walk to useful spots. */

import { busy, errorLine, openDialog } from "../shared/dialogs.js";
import { h, icon } from "../shared/dom.js";
import { metresText } from "../shared/format.js";
import { locale, t, tn } from "../shared/i18n.js";
import { CLASSES, PlanLayer } from "../shared/map/plan-layer.js";
import { lookText, reasonText } from "../shared/plan-words.js";
import { AreaBox } from "./area-box.js";
import { piecesSection } from "./pieces-section.js";

const MOST = 100;
const percent = new Intl.NumberFormat(locale, { style: "percent", maximumFractionDigits: 0 });

/**
 * Open the dialog.
 * @param {Object} page store, server, refresh and view
 */
export function planDialog({ store, server, refresh, view }) {
  const error = errorLine();
  const layer = new PlanLayer(store).addTo(view.map);
  const count = h("input", { class: "input input--short", type: "number", min: 1, max: MOST, value: 12, "data-testid": "plan-count" });
  const inArea = h("input", { type: "checkbox", id: "plan-in-area" });
  const shown = h("input", { type: "checkbox", id: "plan-cells", checked: true });
  const legend = legendList();
  const overlay = h("div", { class: "stack stack--tight", hidden: true },
    h("label", { class: "check small" }, shown, t("Show how well each part is recognised")), legend);
  const outcome = h("div", { class: "stack stack--tight", "aria-live": "polite", "data-testid": "plan-outcome" });
  const make = h("button", { class: "button button--primary", type: "button", "data-testid": "plan-make" }, t("Plan"));
  const pieces = piecesSection({ store, server, refresh });
  let area = null;
  const dialog = openDialog(t("Where to take the next photos"), [
    h("p", { class: "soft" }, t("Spots and directions in which a few more photos help most, as a short walk.")),
    h("label", { class: "row" }, h("span", {}, t("Spots")), count),
    h("label", { class: "check small" }, inArea, t("In an area that I draw on the image; else near the photos")),
    overlay,
    outcome,
    error,
    pieces.box,
  ], { actions: [make], modeless: true });

  const show = ({ plan, current, replaced }) => {
    if (replaced) {
      outcome.replaceChildren(h("p", {}, t("The image was replaced after the last plan: plan again.")));
      return;
    }
    layer.show(plan);
    overlay.hidden = !plan;
    outcome.replaceChildren(...(plan ? [...summary(store.slug, plan, current), spotList(plan, view), ...ways(store, plan)] : []));
  };
  const ask = async (question) => {
    try {
      error.show(null);
      show(await question());
    } catch (problem) {
      error.show(problem);
    }
  };
  shown.addEventListener("change", () => {
    layer.show(layer.plan, { cells: shown.checked });
    legend.hidden = !shown.checked;
  });
  inArea.addEventListener("change", () => {
    area?.remove();
    area = inArea.checked ? new AreaBox(view, () => {}) : null;
  });
  make.addEventListener("click", () => busy(make, () => ask(() => server.makePlan({ spots: count.valueAsNumber, area: area?.sides ?? null }))));
  dialog.addEventListener("close", () => {
    area?.remove();
    layer.remove();
    pieces.close();
  });
  ask(server.plan);
}

function legendList() {
  const step = 1 / CLASSES.length;
  const rows = CLASSES.map((colour, n) => {
    const swatch = h("span", { class: "ed-swatch" });
    swatch.style.background = colour;
    return h("li", {}, swatch, `${Math.round(100 * n * step)}–${percent.format((n + 1) * step)}`);
  });
  return h("ul", { class: "ed-swatches small", "data-testid": "plan-legend" }, ...rows, h("li", { class: "soft" }, t("paler: less certain")));
}

/** Recognition rate now and expected, and what the estimate is based on. */
function summary(slug, plan, current) {
  const way = plan.walk_m === null ? null : t("{distance} on foot", { distance: `${metresText(Math.round(plan.walk_m))} m` });
  const counted = tn("{n} spot", "{n} spots", plan.spots.length);
  const shares = t("Recognised now: {now}; with these photos about {then}", {
    now: percent.format(plan.recognised_share), then: percent.format(plan.expected_share),
  });
  const by = {
    evaluation: () => tn("From evaluating {n} photo.", "From evaluating {n} photos.", plan.tried),
    health: () => tn("From a survey of {n} photo.", "From a survey of {n} photos.", plan.tried),
    none: () => t("From photo positions only."),
  }[plan.trials]();
  const advice = plan.trials === "evaluation" ? null : h("a", { href: `/maps/${encodeURIComponent(slug)}/quality` }, t("Evaluate the map for a better plan"));
  return [
    h("p", {}, h("strong", {}, [counted, way].filter(Boolean).join(" · "))),
    h("p", { class: "small" }, shares),
    h("p", { class: "small soft" }, by, " ", advice, current ? "" : ` ${t("The map has changed since.")}`),
  ];
}

function spotList({ spots }, view) {
  const row = ({ number, x_px: x, y_px: y, headings_deg: headings, reason }) => h("li", { "data-testid": "plan-spot" },
    h("button", { class: "ed-spot", type: "button", onclick: () => view.focus([[x, y]]) },
      h("span", { class: "ed-spot__number" }, number),
      h("span", {}, lookText(headings), h("span", { class: "ed-spot__reason soft" }, reasonText(reason)))));
  return h("ol", { class: "small ed-rest", "aria-label": t("Spots") }, ...spots.map(row));
}

/** Ways to get the plan onto a phone: a GPX file, or the page for the field. */
function ways(store, plan) {
  const slug = encodeURIComponent(store.slug);
  const known = plan.spots.some(({ lat }) => lat !== null);
  return [h("p", { class: "row" },
    known && h("a", { class: "button", href: `/api/v1/maps/${slug}/photo-plan/walk.gpx`, download: true, "data-testid": "plan-gpx" }, icon("download"), "GPX"),
    h("a", { class: "button", href: `/field?map=${slug}`, "data-testid": "plan-field" }, icon("route"), t("Open in the field")))];
}
