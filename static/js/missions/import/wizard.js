/**
 * The dialog that imports files with tracks: choose files, preview their contents and positions, import.
 *
 * A file is uploaded once to a temporary place on the server, and imported from there. Its contents are shown before
 * anything is stored.
 */

import { busy, errorLine, field, openDialog } from "../../shared/dialogs.js";
import { byId, h, icon, queryAll } from "../../shared/dom.js";
import { t } from "../../shared/i18n.js";
import { toastError } from "../../shared/toast.js";
import { fileEndpoints } from "../endpoints.js";
import { FilePanel } from "./file-panel.js";
import { fileLine, remarkList } from "./file-remarks.js";
import { Preview } from "./preview.js";
import { StagedFile } from "./staged-file.js";
import { startFields } from "./start-fields.js";
import { StartPose } from "./start-pose.js";

/** What the page says about the formats of files: endings, and names for people. */
const { formats } = JSON.parse(byId("page").textContent);
const STEPS = ["files", "contents", "result"];
const OPEN = new Set(["sending", "reading"]);

/** @type {?Wizard} the open dialog, which takes dropped files */
let opened = null;

/**
 * @typedef {Object} Destination the mission that files go into
 * @property {Array<Node>} [fields] fields to choose it
 * @property {function(StagedFile): Object} wish fields of the import request; called with the file
 * @property {function(StagedFile[]): void} [propose] fills fields from the contents of files
 * @property {function(): Promise<{place: import("./preview.js").Place, start: ?Object}>} look its surroundings and start
 * @property {function(function(): void): void} [onChange] registers a callback for changes of `look`
 */

/**
 * Ask for files and import them, one after the other.
 * @param {{files?: Array<File>, into: Destination, done: function(number, Array<Object>): void}} what `done` is called with the
 *   mission and the results of the jobs, once the dialog is closed
 */
export function importDialog({ files = [], into, done }) {
  if (opened?.dialog.open) return opened.exchange(files);
  opened = new Wizard(into, done);
  return opened.open(files);
}

class Wizard {
  constructor(into, done) {
    this.into = into;
    this.done = done;
    /** @type {StagedFile[]} */
    this.files = [];
    this.mission = null;
    this.results = [];
    this.start = new StartPose();
    this.start.addEventListener("change", () => this._error.show(null));
    this.preview = new Preview(this.start);
    this._shown = null; // file whose contents are shown
    this._panel = null;
    this._step = "files";
    /** @type {?HTMLButtonElement} */
    this._cancel = null;
    this._build();
  }

  open(files) {
    this.dialog = openDialog(t("Import tracks"), [this._steps, ...Object.values(this._parts), this._error], { actions: [this._back, this._next] });
    this.dialog.classList.add("im-dialog");
    [this._cancel] = queryAll(".dialog__actions > .button", HTMLButtonElement, this.dialog);
    this.dialog.addEventListener("close", () => this._close());
    this._go("files");
    this._lookAtPlace().catch((problem) => this._error.show(problem));
    this.into.onChange?.(() => this._lookAtPlace().catch((problem) => this._error.show(problem)));
    if (files.length) this._take(files);
  }

  _build() {
    const about = t("Recognised by their content: {formats}.", { formats: formats.names });
    this._input = h("input", { class: "input", type: "file", multiple: true, accept: formats.accept, "data-testid": "track-file" });
    this._input.addEventListener("change", () => this._take([...this._input.files]));
    this._steps = h("ol", { class: "im-steps small" });
    this._error = errorLine();
    this._lines = h("div", { class: "im-lines", "aria-live": "polite" });
    this._tabs = h("div", { class: "im-files", role: "group", "aria-label": t("Files") });
    this._side = h("div", { class: "im-side" });
    this._startBox = startFields(this.start);
    this._results = h("div", { class: "im-lines", "aria-live": "polite", "data-testid": "import-remarks" });
    this._parts = {
      files: h("div", { class: "stack" }, field(t("Files"), this._input, about), this._lines),
      contents: h("div", { class: "im-contents", tabindex: -1, role: "group", "aria-label": t("Preview") },
        h("div", { class: "im-column stack" }, this._tabs, this._side, ...(this.into.fields ?? [])),
        h("div", { class: "im-column stack" }, this.preview.element, this._startBox)),
      result: h("div", { class: "stack", tabindex: -1, role: "group", "aria-label": t("Import") }, this._results),
    };
    this._back = h("button", { class: "button", type: "button", "data-testid": "import-back", onclick: () => this._goBack() }, t("Back"));
    this._next = h("button", { class: "button button--primary", type: "button", "data-testid": "import-start" });
    this._next.addEventListener("click", () => busy(this._next, async () => (this._step === "result" ? this._finish() : this._import())).catch(toastError));
  }

  /** @param {"files"|"contents"|"result"} step */
  _go(step) {
    this._step = step;
    this.dialog.dataset.step = step;
    for (const [name, part] of Object.entries(this._parts)) part.hidden = name !== step;
    const names = { files: t("Files"), contents: t("Preview"), result: t("Import") };
    this._steps.replaceChildren(...STEPS.map((name) => h("li", { "aria-current": name === step ? "step" : null }, names[name])));
    this._back.hidden = step === "files" || (step === "result" && !this.files.some(({ state }) => state === "failed"));
    this._next.hidden = step === "files";
    this._cancel.hidden = step === "result";
    this._next.replaceChildren(...(step === "result" ? [t("Done")] : [icon("upload"), t("Import")]));
    this._error.show(null);
    if (step !== "files") this._parts[step].focus({ preventScroll: true });
  }

  _goBack() {
    if (this._step === "contents") return this._forget();
    this._drop(this.files.filter(({ state }) => state === "done"));
    return this._showContents();
  }

  /** Replace the files, unless an import is running. */
  exchange(files) {
    if (this._step === "result" || !files.length) return;
    this._forget();
    this._take(files);
  }

  /** Start again with other files. */
  _forget() {
    this._drop(this.files);
    this._input.value = "";
    this._lines.replaceChildren();
    this._go("files");
    this._input.focus();
  }

  _drop(files) {
    for (const file of files) file.close();
    this.files = this.files.filter((file) => !files.includes(file));
  }

  /** @param {File[]} chosen */
  _take(chosen) {
    if (!chosen.length) return;
    this._drop(this.files);
    this.files = chosen.map((file) => new StagedFile(file, fileEndpoints));
    for (const file of this.files) file.addEventListener("change", () => this._changed(file));
    this._openAll(this.files).catch(toastError);
  }

  /** Upload and read the files one after the other, then show their contents. */
  async _openAll(files) {
    for (const file of files) if (this.files.includes(file)) await file.open();
    if (!files.every((file) => this.files.includes(file))) return;
    if (this.dialog.open && files.some(({ isUsable }) => isUsable)) this._showContents();
  }

  _changed(file) {
    if (this._step === "files") this._lines.replaceChildren(...this.files.map(fileLine));
    if (this._step === "result") this._showResults();
    if (this._step !== "contents") return;
    this._error.show(null);
    this._showTabs();
    if (file === this._shown) this._showPicture();
  }

  _showContents() {
    this._go("contents");
    for (const { contents } of this.files) this._proposeStart(contents?.start);
    this.into.propose?.(this._usable);
    this._showFile(this.files.find(({ isUsable }) => isUsable));
  }

  /** @param {StagedFile} file */
  _showFile(file) {
    this._panel?.close();
    this._shown = file;
    this._panel = new FilePanel(file);
    this._side.replaceChildren(this._panel.element);
    this._showTabs();
    this._showPicture();
  }

  /** Show a tab for each of several files; rejected files show the reason. */
  _showTabs() {
    this._tabs.hidden = this.files.length < 2;
    const hasFocus = this._tabs.contains(document.activeElement);
    this._tabs.replaceChildren(...this.files.map((file) => h("button", {
      class: "im-tab", type: "button", disabled: !file.isUsable, "aria-pressed": String(file === this._shown), onclick: () => this._showFile(file),
    }, fileLine(file))));
    if (hasFocus) queryAll("[aria-pressed=true]", HTMLButtonElement, this._tabs)[0]?.focus();
  }

  _showPicture() {
    this.preview.show(this._shown.wanted);
    this._startBox.hidden = !this._shown.inMetres.length;
  }

  get _usable() {
    return this.files.filter(({ isUsable }) => isUsable);
  }

  /** Begin with the start of the mission, or with that which positions in a file give. */
  _proposeStart(start) {
    if (start && this.start.isEmpty) this.start.set([start.lat, start.lon, start.heading_deg]);
  }

  async _lookAtPlace() {
    const { place, start } = await this.into.look();
    this._proposeStart(start);
    this.preview.setPlace(place);
  }

  /** Message why nothing can be imported yet, or null; shows the file that lacks a start. */
  _objection() {
    const [waiting, broken] = [this._usable.find(({ state }) => OPEN.has(state)), this._usable.find(({ state, error }) => error && state !== "failed")];
    if (waiting) return t("Wait a moment: {file} is being read.", { file: waiting.name });
    if (broken) return t("Cannot read {file} like this.", { file: broken.name });
    const empty = this._usable.find(({ isEmpty }) => isEmpty);
    if (empty) return empty.contents.problem || t("Nothing selected in {file}.", { file: empty.name });
    const file = this._usable.find(({ inMetres }) => inMetres.length);
    if (!file || this.start.whole) return null;
    if (!this._shown.inMetres.length) this._showFile(file);
    const name = file.inMetres[0].track || file.name;
    return this.start.problem || t("The positions of {name} are in metres from where the robot started: set its start and heading, or leave it out.", { name });
  }

  async _import() {
    const objection = this._objection();
    this._error.show(objection && { message: objection });
    if (objection) return;
    const open = this._usable.filter(({ state }) => state !== "done");
    this._go("result");
    this._back.hidden = true;
    this._cancel.hidden = false;
    this._showResults();
    for (const file of open) {
      const wish = this.mission === null ? this.into.wish(file) : { mission: this.mission };
      const start = file.inMetres.length ? this.start.whole : null;
      this.mission = (await file.bringIn({ ...wish, start })) ?? this.mission;
      if (file.result) this.results.push(file.result);
      if (!this.dialog.open) return;
    }
    this._go("result");
    this._showResults();
    if (this.files.every(({ state, result }) => state === "done" && !result.skipped.length && !result.doubts.length)) this._finish();
  }

  _showResults() {
    this._results.replaceChildren(...this.files.map((file) => h("div", {}, fileLine(file), ...(file.result ? remarkList({ ...file.result, notes: [] }) : []))));
  }

  _finish() {
    this.dialog.close();
  }

  _close() {
    this._panel?.close();
    this._drop(this.files);
    if (this.results.length) this.done(this.mission, this.results);
  }
}
