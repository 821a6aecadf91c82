/** The georeference: input, preview of the server's result, and then the change. */

import { del, post, put } from "../shared/api.js";
import { busy, confirmDialog } from "../shared/dialogs.js";
import { byId, h } from "../shared/dom.js";
import { metresText } from "../shared/format.js";
import { locale, t } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";
import { ControlPoints } from "./control-points.js";
import { cornersForm, worldfileForm } from "./corner-forms.js";
import { base, movedPhotoNotes, note, page, panels, reloadWith } from "./page.js";

const WAIT_MS = 350;

/** Connect the section, once it is unfolded: a hidden map has no size. */
export function georeferenceSection() {
  const section = byId("where", HTMLDetailsElement);
  if (section.open) connect();
  else section.addEventListener("toggle", connect, { once: true });
}

function connect() {
  const judge = new Verdict();
  const points = new ControlPoints(() => judge.ask());
  const sources = {
    "control-points": { wish: () => points.wish(), show: (received) => points.show(received) },
    corners: { wish: cornersForm(() => judge.ask()) },
    worldfile: { wish: worldfileForm(() => judge.ask()) },
  };
  const choose = panels("known", (kind) => {
    judge.from(sources[kind]);
    if (kind === "control-points") points.open();
  });
  choose("control-points");
  byId("apply", HTMLButtonElement).addEventListener("click", (event) => {
    busy(event.currentTarget, () => apply(judge.wish)).catch(toastError);
  });
  document.getElementById("forget")?.addEventListener("click", (event) => {
    busy(event.currentTarget, forget).catch(toastError);
  });
}

async function apply(wish) {
  const answer = await put(`${base}/georeference`, { ...wish, seen: page.revision });
  reloadWith([{ kind: "success", text: t("The map is georeferenced.") }, ...movedPhotoNotes(answer.from_tray, answer.to_tray)]);
}

async function forget() {
  const title = t("Remove the georeference?");
  const text = t("Photos stay where they are on the image. You can undo this.");
  if (!(await confirmDialog({ title, text, action: t("Remove it") }))) return;
  await del(`${base}/georeference`);
  reloadWith([{ kind: "success", text: t("The georeference was removed.") }]);
}

/** Requests the server's verdict on an input, and shows it. */
class Verdict {
  constructor() {
    this.source = null;
    this.wish = null;
    this.asked = 0;
    this.timer = null;
  }

  /** Use another form as the source. */
  from(source) {
    this.source = source;
    this.ask();
  }

  /** Send a request after a pause in typing. */
  ask() {
    if (!this.source) return;
    clearTimeout(this.timer);
    byId("apply", HTMLButtonElement).disabled = true;
    this.timer = setTimeout(() => this._ask(), WAIT_MS);
  }

  async _ask() {
    const { source } = this;
    const wish = source.wish();
    this.asked += 1;
    const mine = this.asked;
    if (!wish) return this._show(source, null, []);
    try {
      const received = await post(`${base}/georeference/preview`, wish);
      if (mine !== this.asked) return null;
      this.wish = wish;
      return this._show(source, received, verdict(received));
    } catch (error) {
      if (mine !== this.asked) return null;
      if (![400, 422].includes(error.status)) toastError(error);
      return this._show(source, null, [note("danger", error.message, error.hint)]);
    }
  }

  _show(source, received, content) {
    byId("verdict").replaceChildren(...content);
    byId("apply", HTMLButtonElement).disabled = !received;
    source.show?.(received);
  }
}

function verdict(received) {
  const facts = [[t("Fit"), kindName(received.kind)]];
  if (received.rms_m !== null && received.rms_m !== undefined) {
    facts.push([t("Residuals"), t("{rms} m RMS, {most} m maximum", { rms: metresText(received.rms_m), most: metresText(Math.max(...received.residuals)) })]);
  }
  if (received.metres_per_pixel) {
    facts.push([t("Scale"), t("{metres} m per pixel", { metres: metresText(received.metres_per_pixel) })]);
    const { width, height } = page.satellite;
    facts.push([t("Extent"), `${Math.round(width * received.metres_per_pixel)} × ${Math.round(height * received.metres_per_pixel)} m`]);
  }
  if (Math.abs(received.north_deg ?? 0) >= 0.05) facts.push([t("North"), t("{degrees}° clockwise from the top", { degrees: received.north_deg.toLocaleString(locale, { minimumFractionDigits: 1, maximumFractionDigits: 1 }) })]);
  const list = h("dl", { class: "facts number" }, ...facts.flatMap(([name, value]) => [h("dt", {}, name), h("dd", {}, value)]));
  return [list, ...received.warnings.map((text) => note("warning", text))];
}

function kindName(kind) {
  const names = {
    corners: t("corners"),
    worldfile: t("world file"),
    similarity: t("similarity: shift, rotation, one scale"),
    affine: t("affine: two scales and a skew"),
    projective: t("projective: images taken at an angle"),
  };
  return names[kind] || kind;
}
