/** The page of the control points: naming, clicking in photos and on the image, residuals. */

import { busy } from "../shared/dialogs.js";
import { byId, h, icon, queryAll } from "../shared/dom.js";
import { metresText } from "../shared/format.js";
import { locale, t, tn } from "../shared/i18n.js";
import { clamped, latLngOf, pixelOf } from "../shared/map/coords.js";
import { imageMap } from "../shared/map/image-map.js";
import { pin } from "../shared/map/pin.js";
import { Arrows } from "../shared/map/residual-arrows.js";
import { toastError } from "../shared/toast.js";
import { landmarksOf } from "./endpoints.js";
import { TagForm } from "./tag-form.js";

const ASK_MS = 1000;
const SHOWN = 200;
const page = JSON.parse(byId("page").textContent);
const server = landmarksOf(page.slug);

if (document.getElementById("map-view")) start().catch(toastError);

/** @typedef {Api["ControlPointOut"]} Point */

async function start() {
  /** @type {Point[]} */
  let points = [];
  let chosen = "";
  let photo = page.photos[0];
  let canUndo = false;
  let asked = 0;
  let waiting = 0;
  let sent = Promise.resolve();
  let photoView = null;
  const chooser = byId("photo", HTMLSelectElement);
  const map = imageMap(byId("map-view"), page.satellite);
  const arrows = new Arrows(map);
  const mapPins = L.layerGroup().addTo(map);
  const current = () => points.find(({ name }) => name === chosen);
  const tagForm = new TagForm((tag) => change({ tag }));

  const connectEditing = () => {
    const field = byId("new-name", HTMLInputElement);
    byId("add").addEventListener("submit", (event) => {
      event.preventDefault();
      const name = field.value.trim();
      if (!name) return field.focus();
      chosen = name;
      field.value = "";
      if (current()) return render();
      return keep({ name, x_px: null, y_px: null, height_m: null, accuracy_m: null, photos: [], tag: null, check: false });
    });
    byId("undo").addEventListener("click", () => busy(byId("undo", HTMLButtonElement), undo).catch(toastError));
    byId("unclick").addEventListener("click", () => change({ photos: current().photos.filter(({ id }) => id !== photo.id) }));
  };

  const undo = async () => {
    await sent;
    // check again: another page may have edited the map since, which must not be undone here
    if ((await server.points()).can_undo) await server.undo();
    take(await server.points());
  };

  const step = (by) => {
    const count = page.photos.length;
    showPhoto(page.photos[(page.photos.indexOf(photo) + by + count) % count]);
  };

  /** Change fields of the chosen point. */
  const change = (fields) => {
    const point = current();
    if (point && page.can_edit) keep({ ...point, ...fields });
  };

  const clickMap = (latlng) => {
    const [x, y] = clamped(pixelOf(latlng), page.satellite);
    change({ x_px: x, y_px: y });
  };

  const clickPhoto = (latlng) => {
    const [x, y] = clamped(pixelOf(latlng), photo);
    const others = (current()?.photos ?? []).filter(({ id }) => id !== photo.id);
    change({ photos: [...others, { id: photo.id, x: x / photo.width, y: y / photo.height }] });
  };

  /** Show a point at once, and send it after pending requests. @param {Point} point */
  const keep = (point) => {
    const { name, ...fields } = point;
    points = [...points.filter((other) => other.name !== name), point].sort((a, b) => (a.name < b.name ? -1 : 1));
    render();
    return send(() => server.keepPoint(name, fields));
  };

  const remove = (name) => send(() => server.removePoint(name));

  const send = (request) => {
    waiting += 1;
    sent = sent.then(request).then(
      (received) => {
        waiting -= 1;
        if (!waiting) take(received);
      },
      async (error) => {
        waiting -= 1;
        toastError(error);
        if (!waiting) take(await server.points());
      },
    );
    return sent;
  };

  /** Show the server's state; poll while a job recomputes the landmarks. */
  const take = (received) => {
    points = received.points;
    canUndo = received.can_undo;
    if (!current()) chosen = points[0]?.name ?? "";
    showResiduals(received);
    render();
    asked += 1;
    if (received.job !== null && !received.current) follow(asked);
  };

  const follow = async (mine) => {
    await new Promise((resolve) => setTimeout(resolve, ASK_MS));
    if (mine !== asked || waiting) return;
    if (document.hidden) follow(mine);
    else server.points().then((received) => mine === asked && !waiting && take(received), toastError);
  };

  const showPhoto = (next) => {
    photo = next;
    chooser.value = String(photo.id);
    photoView?.map.remove();
    const view = imageMap(byId("photo-view"), { url: photo.preview, width: photo.width, height: photo.height, tiles: null });
    view.on("click", ({ latlng }) => clickPhoto(latlng));
    photoView = { map: view, pins: L.layerGroup().addTo(view) };
    render();
  };

  const render = () => {
    const point = current();
    const shown = new Set(point?.photos.map(({ id }) => id));
    page.photos.forEach(({ id, name }, n) => (chooser.options[n].textContent = shown.has(id) ? `✓ ${name}` : name));
    if (page.can_edit) {
      byId("unclick").hidden = !shown.has(photo?.id);
      byId("undo", HTMLButtonElement).disabled = !canUndo;
    }
    byId("next").textContent = nextStep(point);
    tagForm.show(point);
    byId("points-frame").hidden = points.length === 0;
    const focused = document.activeElement?.getAttribute("data-key");
    byId("points").replaceChildren(...points.map(row));
    if (focused) queryAll(`[data-key="${CSS.escape(focused)}"]`, HTMLElement)[0]?.focus();
    drawPins();
  };

  const drawPins = () => {
    mapPins.clearLayers();
    photoView?.pins.clearLayers();
    points.forEach((point, n) => {
      const number = n + 1;
      const mine = point.name === chosen;
      if (point.x_px !== null) marker(mapPins, [point.x_px, point.y_px], { number, mine, title: point.name }, clickMap);
      const click = photo && point.photos.find(({ id }) => id === photo.id);
      if (click) marker(photoView.pins, [click.x * photo.width, click.y * photo.height], { number, mine, title: point.name }, clickPhoto);
    });
  };

  const marker = (layer, at, { number, mine, title }, moved) => {
    const options = { draggable: mine && page.can_edit, keyboard: false, title, icon: pin(number, mine ? "sat-pin--chosen" : ""), zIndexOffset: mine ? 1000 : 0 };
    const made = L.marker(latLngOf(at), options).addTo(layer);
    made.on("dragend", () => moved(made.getLatLng()));
    if (!mine) made.on("click", () => choose(title));
  };

  const choose = (name) => {
    chosen = name;
    render();
  };

  const row = (point) => {
    const cell = (text) => h("td", { class: "number nowrap" }, text);
    const fact = (field, label) => {
      if (!page.can_edit) return cell(point[field] ?? "–");
      const input = h("input", {
        class: "input number", type: "number", step: "any", inputmode: "decimal", value: point[field] ?? "", "data-key": `${field} ${point.name}`,
        "aria-label": t("Point {number}: {what}", { number: point.name, what: label }),
        onchange: (event) => keep({ ...point, [field]: Number.isFinite(event.target.valueAsNumber) ? event.target.valueAsNumber : null }),
      });
      return h("td", {}, input);
    };
    const check = h("input", {
      type: "checkbox", checked: point.check, disabled: !page.can_edit, "data-key": `check ${point.name}`,
      "aria-label": t("Point {number}: {what}", { number: point.name, what: t("check point") }),
      onchange: (event) => keep({ ...point, check: event.target.checked }),
    });
    const number = points.indexOf(point) + 1;
    const name = h("button", { class: "button button--quiet", type: "button", "aria-pressed": String(point.name === chosen), "data-key": point.name, onclick: () => choose(point.name) }, `${number} · ${point.name}`);
    const away = h("button", { class: "icon-button", type: "button", "aria-label": t("Remove the point {name}", { name: point.name }), onclick: () => remove(point.name) }, icon("trash"));
    return h(
      "tr", {},
      h("th", { scope: "row" }, name),
      cell(point.photos.length),
      cell(pixelText(point.x_px)),
      cell(pixelText(point.y_px)),
      fact("height_m", t("height")),
      fact("accuracy_m", t("accuracy")),
      h("td", {}, h("label", { class: "check" }, check)),
      h("td", {}, page.can_edit && away),
    );
  };

  const showResiduals = ({ residuals, accuracy, laid, current: isCurrent, job }) => {
    byId("not-laid").hidden = laid;
    byId("residuals-card").hidden = !laid;
    byId("laying").hidden = isCurrent || job === null;
    byId("rmse").replaceChildren(...rmseLines(accuracy).map((line) => h("li", {}, line)));
    byId("residuals").replaceChildren(...residuals.slice(0, SHOWN).map(residualRow));
    const known = residuals.filter(({ others_x_px: x }) => x !== null);
    arrows.show(known.map((one) => [latLngOf([one.x_px, one.y_px]), latLngOf([one.others_x_px, one.others_y_px])]));
  };

  map.on("click", ({ latlng }) => clickMap(latlng));
  chooser.append(...page.photos.map(({ id, name }) => h("option", { value: id }, name)));
  chooser.addEventListener("change", () => showPhoto(page.photos.find(({ id }) => id === Number(chooser.value))));
  byId("before").addEventListener("click", () => step(-1));
  byId("after").addEventListener("click", () => step(1));
  if (page.can_edit) connectEditing();
  if (photo) showPhoto(photo);
  take(await server.points());
  chosen = points[0]?.name ?? "";
  render();
}

function nextStep(point) {
  if (!page.can_edit) return "";
  if (!point) return t("Name a point that you find on the image and in two photos.");
  if (point.tag) {
    if (point.x_px === null) return t("{name}: click it on the image of the map.", { name: point.name });
    return t("{name} is complete: photos that show its tag are localized by it.", { name: point.name });
  }
  if (!page.photos.length) return t("{name}: choose the tag that is mounted there, as the map has no photos.", { name: point.name });
  const missing = 2 - point.photos.length;
  if (missing > 0) return tn("{name}: click it in {n} more photo.", "{name}: click it in {n} more photos.", missing, { name: point.name });
  if (point.x_px === null) return t("{name}: click it on the image of the map.", { name: point.name });
  return t("{name} is complete; more photos make it more exact.", { name: point.name });
}

function pixelText(coordinate) {
  return coordinate === null ? "–" : coordinate.toLocaleString(locale, { minimumFractionDigits: 1, maximumFractionDigits: 1 });
}

/** @param {Api["AccuracyOut"] | null} accuracy */
function rmseLines(accuracy) {
  if (!accuracy) return [];
  const { control, check } = accuracy;
  const lines = [];
  if (control.points) lines.push(tn("Control points: RMSE {rmse} of {n} point, from where all others put it.", "Control points: RMSE {rmse} of {n} points, each from where all others put it.", control.points, { rmse: rmseText(control) }));
  if (check.points) {
    lines.push(tn("Check points: RMSE {rmse} of {n} point that took no part in the fit.", "Check points: RMSE {rmse} of {n} points that took no part in the fit.", check.points, { rmse: rmseText(check) }));
    if (check.rmse_m !== null) lines.push(t("Check points, by direction: RMSE {east} m east, {north} m north.", { east: metresText(check.rmse_east_m), north: metresText(check.rmse_north_m) }));
    if (check.rmse_height_m !== null) lines.push(tn("Check points, height: RMSE {rmse} m of {n} point.", "Check points, height: RMSE {rmse} m of {n} points.", check.heights, { rmse: metresText(check.rmse_height_m) }));
  }
  return lines;
}

/** @param {Api["RmseOut"]} rmse */
function rmseText({ rmse_m: metres, rmse_px: pixels, uncertainty }) {
  return `${lengthText(metres, pixels)} ± ${Math.round(100 * uncertainty)} %`;
}

function lengthText(metres, pixels) {
  return metres === null ? `${metresText(pixels)} px` : `${metresText(metres)} m`;
}

/** @param {Api["ResidualOut"]} one */
function checkText(one) {
  const signed = (value) => value.toLocaleString(locale, { signDisplay: "exceptZero", minimumFractionDigits: 2, maximumFractionDigits: 2 });
  const parts = [
    one.east_m === null
      ? t("{dx} px right, {dy} px down", { dx: signed(one.dx_px), dy: signed(one.dy_px) })
      : t("{east} m east, {north} m north", { east: signed(one.east_m), north: signed(one.north_m) }),
  ];
  if (one.height_off_m !== null) parts.push(t("{up} m in height", { up: signed(one.height_off_m) }));
  parts.push(tn("seen in {n} photo", "seen in {n} photos", one.photos));
  parts.push(t("itself accurate to {sigma}", { sigma: lengthText(one.sigma_m, one.sigma_px) }));
  return parts.join(", ");
}

function residualRow(one) {
  const length = one.residual_px === null ? "–" : lengthText(one.residual_m, one.residual_px);
  const remarks = [
    one.check && h("span", { class: "badge" }, t("check point")),
    one.check && one.dx_px !== null && h("span", {}, " ", checkText(one)),
    one.contradicts && h("span", { class: "badge badge--danger" }, t("left out: it contradicts the others")),
    one.wrong_clicks.length > 0 && h("span", { class: "badge badge--warning" }, t("wrong click in {photos}", { photos: one.wrong_clicks.join(", ") })),
    one.problem && h("span", {}, one.problem),
  ];
  const symbol = icon(one.photo === null ? "pin" : "image");
  return h("tr", { "data-name": one.name }, h("th", { scope: "row" }, symbol, " ", one.name), h("td", { class: "number nowrap" }, length), h("td", {}, ...remarks));
}
