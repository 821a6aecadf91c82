/** The page of the landmarks: points and cameras from above and in space, and the job that computes them. */

import { Box3, Vector3 } from "three";
import { busy, openDialog } from "../shared/dialogs.js";
import { byId, h, queryAll } from "../shared/dom.js";
import { duration, labelled, locale, t, tn } from "../shared/i18n.js";
import { showLastFailure } from "../shared/job-failure.js";
import { queuedText } from "../shared/job-list.js";
import { roundLength } from "../shared/map/coords.js";
import { mapCredit } from "../shared/photo-credit.js";
import { toastError } from "../shared/toast.js";
import { CameraCard, lengthText, nameOf } from "./camera-card.js";
import { landmarksOf, sharedLandmarks } from "./endpoints.js";
import { Frusta } from "./frusta.js";
import { groundOf } from "./ground.js";
import { rampGradient } from "./height-ramp.js";
import { unpack, usualHeights } from "./point-blocks.js";
import { PointLayer } from "./point-layer.js";
import { Stage } from "./stage.js";

const ASK_MS = 1000;
const FRUSTUM = 0.012;
const page = JSON.parse(byId("page").textContent);
const map = page.slug ? landmarksOf(page.slug) : null; // null for visitors, who can only look
const server = map ?? sharedLandmarks(page.token);
const canvas = byId("scene", HTMLCanvasElement);
const size = byId("point-size", HTMLInputElement);
const seen = byId("least-seen", HTMLInputElement);
const colour = byId("colour", HTMLSelectElement);
const chooser = byId("photo", HTMLSelectElement);

start().catch(toastError);

async function start() {
  const cloud = await server.show();
  if (cloud.key === null) byId("none").hidden = false;
  else show(cloud);
  if (!map) return;
  const build = document.getElementById("build");
  build?.addEventListener("click", () => busy(build, async () => follow((await map.build()).job)).catch(toastError));
  byId("update").addEventListener("click", () => map.build().then(({ job }) => follow(job)).catch(toastError));
  showLeftOut(cloud);
  if (cloud.job === null) await lastFailure();
  else follow(cloud.job);
}

function lastFailure() {
  return showLastFailure(byId("progress"), page.slug, ["landmarks", "place-rest"]);
}

/** Show the progress of a job, and reload the page when it is done. */
async function follow(id) {
  byId("progress").hidden = false;
  document.querySelector("[data-job-failure]")?.remove();
  for (;;) {
    const job = document.hidden ? null : await map.job(id).catch(toastError);
    if (job?.state === "done") return location.reload();
    if (job?.state === "failed" || job?.state === "cancelled") {
      byId("progress").hidden = true;
      if (job.state === "failed") return lastFailure();
      toastError({ code: "job", message: t("cancelled"), hint: null });
      return undefined;
    }
    if (job) byId("words").textContent = wordsOf(job);
    await new Promise((resolve) => setTimeout(resolve, ASK_MS));
  }
}

function wordsOf(job) {
  const { state, done, total, note, seconds_left: left } = job;
  if (state === "queued") return queuedText(job);
  const parts = [note, total > 0 && t("{done} of {total}", { done, total }), left !== null && t("about {time} left", { time: duration(left) })];
  return parts.filter(Boolean).join(" · ");
}

function show(cloud) {
  let stage;
  try {
    stage = new Stage(canvas, { moved: () => scaleBar(stage, cloud), pick: (camera) => choose(camera) });
  } catch {
    byId("no-webgl").hidden = false;
    return;
  }
  byId("tools").hidden = false;
  const layer = new PointLayer(cloud);
  const ground = groundOf(cloud, page.satellite, () => stage.invalidate());
  const box = boxOf(cloud);
  stage.fit(box);
  const colours = { placed: "#4c9bff", tray: "#00d2a8", chosen: "#ff8a33" };
  const frusta = new Frusta(cloud.cameras, colours, FRUSTUM * stage.extent);
  if (ground) stage.backdrop.add(ground);
  stage.backdrop.add(frusta.object);
  stage.scene.add(layer.object);
  Object.assign(stage, { points: layer, frusta });

  let current = null;
  const card = new CameraCard({ slug: page.slug ?? null, unit: cloud.unit }, {
    step: (by) => step(by),
    look: () => {
      setView("space");
      stage.lookFrom(current, 0.15 * stage.extent);
    },
    close: () => {
      choose(null);
      canvas.focus();
    },
  });
  const choose = (camera) => {
    current = camera;
    chooser.value = camera ? String(camera.id) : "";
    frusta.choose(camera, () => stage.invalidate());
    card.show(camera);
    if (camera) stage.reveal(camera.at, card.box.getBoundingClientRect());
    stage.invalidate();
  };
  const step = (by) => {
    const count = cloud.cameras.length;
    if (!count) return;
    const at = cloud.cameras.indexOf(current);
    choose(cloud.cameras[(at + by + (at < 0 && by < 0 ? 1 : 0) + count) % count]);
  };
  const setView = (name) => {
    for (const button of queryAll("#views button", HTMLButtonElement)) button.setAttribute("aria-pressed", String(button.dataset.view === name));
    stage.show(name);
    scaleBar(stage, cloud);
  };
  const repaint = () => {
    stage.pointSize = size.valueAsNumber;
    layer.set("leastSeen", seen.valueAsNumber);
    layer.set("byHeight", colour.value === "height");
    byId("least-seen-words").textContent = tn("seen by {n} photo or more", "seen by {n} photos or more", seen.valueAsNumber);
    byId("legend-height").hidden = colour.value !== "height";
    frusta.object.visible = byId("cameras", HTMLInputElement).checked;
    byId("legend-cameras").hidden = !frusta.object.visible;
    if (ground) ground.visible = byId("image", HTMLInputElement).checked;
    stage.invalidate();
  };
  prepareTools(cloud, ground);
  for (const input of [size, seen, colour, byId("cameras"), byId("image")]) input.addEventListener("input", repaint);
  for (const button of queryAll("#views button", HTMLButtonElement)) button.addEventListener("click", () => setView(button.dataset.view));
  chooser.addEventListener("change", () => choose(cloud.cameras.find(({ id }) => id === Number(chooser.value)) ?? null));
  byId("fit").addEventListener("click", () => stage.fit(box));
  byId("keys").addEventListener("click", showKeys);
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const toggle = () => {
      byId("cameras", HTMLInputElement).checked = !byId("cameras", HTMLInputElement).checked;
      repaint();
    };
    const run = {
      0: () => stage.fit(box), n: () => step(1), p: () => step(-1), c: toggle, "?": showKeys,
      v: () => setView(stage.name === "space" ? "above" : "space"), Escape: () => choose(null),
    }[event.key];
    if (run) {
      event.preventDefault();
      run();
    }
  });
  repaint();
  const linked = Number(new URLSearchParams(location.search).get("photo") ?? NaN);
  choose(cloud.cameras.find(({ id }) => id === linked) ?? null);
  load(cloud, layer, stage).catch(toastError);
}

/** Fetch the points block by block, showing each as it arrives. */
async function load(cloud, layer, stage) {
  const status = byId("status");
  const number = (n) => n.toLocaleString(locale);
  for (let block = 0; block < cloud.blocks; block += 1) {
    const part = unpack(await server.block(cloud.key, block));
    if (block === 0) {
      const [low, high] = usualHeights(part.steps, cloud.offset[2], cloud.scale[2]);
      layer.set("low", low);
      layer.set("high", high);
      const words = (height) => `${lengthText(height, cloud.unit)} ${cloud.unit}`;
      byId("legend-low").textContent = words(low);
      byId("legend-high").textContent = words(high);
    }
    layer.add(part);
    stage.invalidate();
    status.textContent = t("{n} of {total} points", { n: number(layer.total), total: number(cloud.points) });
  }
  const points = tn("{n} point", "{n} points", cloud.points);
  const photos = t("{n} of {total} photos", { n: number(cloud.cameras.length), total: number(cloud.photos) });
  status.textContent = `${points} · ${photos}`;
  canvas.dataset.points = String(layer.total);
}

/** Box around the cameras with a margin; far outliers among the points are ignored. */
function boxOf(cloud) {
  const box = new Box3();
  for (const { at } of cloud.cameras) box.expandByPoint(new Vector3().fromArray(at));
  if (box.isEmpty()) {
    const low = new Vector3().fromArray(cloud.offset);
    return new Box3(low, low.clone().addScaledVector(new Vector3().fromArray(cloud.scale), 65535));
  }
  const around = 0.08 * box.getSize(new Vector3()).length();
  return box.expandByScalar(Math.max(around, 1e-3));
}

function prepareTools(cloud, ground) {
  byId("ramp").style.background = rampGradient;
  if (!cloud.coloured) {
    colour.value = "height";
    colour.querySelector('[value="photos"]').toggleAttribute("disabled", true);
  }
  byId("image-check").hidden = !ground;
  byId("credit").textContent = [page.satellite?.attribution, mapCredit(cloud.cameras)].filter(Boolean).join(" · ");
  const frame = document.getElementById("frame");
  if (frame) {
    frame.textContent = cloud.unit === "m"
      ? t("Metres to the east, to the north and up; 0 is the height of the placed cameras.")
      : t("Map pixels to the right, towards the top of the image and up; 0 is the height of the placed cameras.");
  }
  chooser.append(...cloud.cameras.map((camera) => h("option", { value: camera.id }, nameOf(camera))));
  byId("legend-tray").hidden = cloud.cameras.every(({ placed }) => placed);
}

/** Show which photos are not in the view; not to visitors. */
function showLeftOut(cloud) {
  byId("new-photos").hidden = !cloud.new_photos || !page.can_edit;
  byId("new-photos-words").textContent = tn("{n} photo was added since.", "{n} photos were added since.", cloud.new_photos);
  const out = cloud.left_out.reduce((sum, { photos }) => sum + photos.length, 0);
  byId("left-out").hidden = !out;
  byId("left-out-words").textContent = tn("{n} photo is joined, but not on the map", "{n} photos are joined, but not on the map", out);
  byId("left-out-reasons").replaceChildren(...cloud.left_out.map(({ photos, reason }) => h("li", {}, labelled(photos.length, reason))));
}

function scaleBar(stage, cloud) {
  const bar = byId("scale");
  bar.hidden = stage.name !== "above";
  if (bar.hidden) return;
  const length = roundLength(110 * stage.unitPerPixel);
  bar.querySelector("span").style.width = `${Math.round(length / stage.unitPerPixel)}px`;
  bar.querySelector("b").textContent = `${length} ${cloud.unit}`;
}

function showKeys() {
  const keys = [
    ["W A S D", t("Fly forward, left, back, right")],
    ["Q E", t("Fly down and up")],
    ["← → ↑ ↓", t("Turn and tilt; from above: move")],
    ["+ −", t("Zoom")],
    ["Shift", t("Faster")],
    ["N P", t("Next and previous photo")],
    ["V", t("From above, or in space")],
    ["C", t("Cameras on and off")],
    ["0", t("Show everything")],
  ];
  openDialog(t("Keys"), [
    h("dl", { class: "lm-keys" }, ...keys.flatMap(([key, words]) => [h("dt", {}, h("kbd", {}, key)), h("dd", {}, words)])),
    h("p", { class: "small soft" }, t("Mouse: drag turns, the right button moves, the wheel zooms. Touch: one finger turns, two move and zoom. A click on a camera shows its photo.")),
  ]);
}
