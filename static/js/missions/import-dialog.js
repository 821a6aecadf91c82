/** The dialog that reads a file into a mission: a track, a recording of a robot, a table. */

import { columnChoice } from "../shared/column-choice.js";
import { busy, errorLine, field, openDialog } from "../shared/dialogs.js";
import { h, icon } from "../shared/dom.js";
import { locale, t } from "../shared/i18n.js";
import { toastError } from "../shared/toast.js";
import { POSE_COLUMNS } from "./csv-columns.js";
import { endpointsOf } from "./endpoints.js";
import { sourceName } from "./format.js";
import { ended, jobBar } from "./job-progress.js";

/** What the file dialog offers. */
export const ACCEPT = ".bag,.mcap,.db3,.gpx,.tcx,.fit,.igc,.geojson,.json,.nmea,.nma,.kml,.kmz,.csv,.txt,.tum,.kitti,.zip,.log";
const SOURCES = ["gps", "odometry", "visual", "manual"];

/**
 * Ask for files and import them, one after the other.
 * @param {Object} what
 * @param {Array<File>} [what.files] chosen already
 * @param {function(File): Promise<number>} what.mission gives the mission that the files go into, made if need be
 * @param {Array<Node>} [what.more] fields in front
 * @param {function(number, Object): void} what.done called with the mission and what the jobs did
 * @param {function(): Promise<void>} [what.undo] called where nothing was imported
 */
export function importDialog({ files = [], mission, more = [], done, undo = async () => {} }) {
  const input = h("input", { class: "input", type: "file", multiple: true, accept: ACCEPT, "data-testid": "track-file" });
  const source = h("select", { class: "select" },
    h("option", { value: "" }, t("as in the file")), ...SOURCES.map((name) => h("option", { value: name }, sourceName(name))));
  const least = h("input", { class: "input", placeholder: "0.00001", autocomplete: "off", inputmode: "text" });
  const axes = h("select", { class: "select", "data-testid": "import-axes" },
    ...[["", t("detected")], ["robot", t("robot: x forward, y left, z up")], ["camera", t("camera: x right, y down, z forward")],
      ["ned", t("x north or forward, y east or right, z down")]].map(([value, label]) => h("option", { value }, label)));
  const start = startFields();
  const columns = columnChoice(POSE_COLUMNS, ({ name }) => /\.(csv|tsv)$/i.test(name));
  const error = errorLine();
  const progress = h("div", { "aria-live": "polite" });
  const send = h("button", { class: "button button--primary", type: "button", "data-testid": "import-start" }, icon("upload"), t("Import"));
  const about = t("Bags of ROS 1 and ROS 2, MCAP, GPX, TCX, FIT, IGC, NMEA, KML, KMZ, GeoJSON, TUM, KITTI and CSV.");
  const known = h("p", { class: "mi-file" }, icon("route"), files.map(({ name }) => name).join(", "));
  const options = h("details", {}, h("summary", {}, t("Options")), h("div", { class: "stack" },
    field(t("Source of the positions"), source),
    field(t("Skip points that moved less than"), least, t("Degrees, or metres such as 0.5m; 0 keeps every point. The distance always includes every point.")),
    field(t("Axes"), axes, t("Of a track in metres: TUM, KITTI or a table.")), start.element));
  const dialog = openDialog(t("Import a track"), [
    files.length ? known : field(t("Files"), input, about), ...more, columns.element, options, progress, error,
  ], { actions: [send] });
  const chosen = () => (files.length ? files : [...input.files]);
  input.addEventListener("change", () => chosen().length && columns.look(chosen()[0]));
  if (files.length) columns.look(files[0]);
  const abort = new AbortController();
  dialog.addEventListener("close", () => abort.abort());

  const run = async () => {
    error.show(null);
    if (!chosen().length) return error.show({ message: t("Choose a file first.") });
    const fields = { source: source.value, min_move: least.value.trim(), columns: columns.value(), axes: axes.value, start: start.value() };
    const results = [];
    const failed = [];
    let running = false; // a job that nobody waits for any more may still store something
    try {
      const id = await mission(chosen()[0]);
      for (const file of chosen()) {
        const job = { begun: false };
        try {
          results.push(await sendFile({ id, file, fields, progress, signal: abort.signal, job }));
        } catch (problem) {
          running ||= job.begun && problem.code !== "job";
          if (problem.name === "AbortError") throw problem;
          failed.push({ file, problem });
        }
      }
      if (!results.length) throw failed[0].problem;
      dialog.close();
      const result = joined(results);
      showRemarks({ ...result, failed }, () => done(id, result));
    } catch (problem) {
      progress.replaceChildren();
      if (problem.name !== "AbortError") error.show(problem);
      if (!results.length && !running) await undo().catch(toastError);
    }
    return null;
  };
  send.addEventListener("click", () => busy(send, run));
}

/** Where the robot was at first, for tracks in its own frame. */
function startFields() {
  const number = (most) => h("input", { class: "input number", type: "number", step: "any", min: -most, max: most, inputmode: "decimal" });
  const labels = [t("Latitude"), t("Longitude"), t("Heading, degrees")];
  const inputs = [90, 180, 360].map(number);
  inputs.forEach((input, place) => input.setAttribute("data-testid", `import-start-${place}`));
  const element = h("fieldset", { class: "stack stack--tight" }, h("legend", {}, t("Start pose of the robot")),
    h("p", { class: "soft small" }, t("Odometry and trajectories in metres begin there. Without it, and without one of the mission, they are left out.")),
    h("div", { class: "mi-start" }, ...inputs.map((input, place) => field(labels[place], input))));
  const value = () => {
    const [lat, lon, heading] = inputs.map((input) => input.value);
    return lat && lon ? `${lat},${lon},${heading || 90}` : "";
  };
  return { element, value };
}

/** What several imports did together. */
function joined(results) {
  const all = (name) => results.flatMap((result) => result[name]);
  return {
    kind: [...new Set(results.map(({ kind }) => kind))].join(", "),
    tracks: all("tracks"),
    objects: results.reduce((sum, { objects }) => sum + objects, 0),
    new: results.some((result) => result.new),
    skipped: all("skipped"),
    doubts: all("doubts"),
  };
}

/** Say what was left out and what is odd, before the import is done with. */
function showRemarks({ skipped, doubts, failed }, then) {
  if (!skipped.length && !doubts.length && !failed.length) return then();
  const lines = (title, remarks) => (remarks.length ? [h("h3", {}, title), h("ul", {}, ...remarks.map(remark))] : []);
  const refused = failed.map(({ file, problem }) => h("li", {}, `${file.name}: ${[problem.message, problem.hint].filter(Boolean).join(". ")}`));
  const dialog = openDialog(t("Imported, with remarks"), [
    h("div", { class: "stack", "data-testid": "import-remarks" }, ...(refused.length ? [h("h3", {}, t("Not imported")), h("ul", {}, ...refused)] : []), ...lines(t("Left out"), skipped), ...lines(t("Odd"), doubts)),
  ]);
  dialog.addEventListener("close", then);
  return null;
}

const remark = ({ count, reason, where }) => h("li", {}, `${count.toLocaleString(locale)} ${reason} (${where})`);

async function sendFile({ id, file, fields, progress, signal, job: state }) {
  const server = endpointsOf(id);
  const body = new FormData();
  body.append("file", file, file.name);
  for (const [name, value] of Object.entries(fields)) if (value) body.append(name, value);
  const sending = jobBar(t("Sending the file..."));
  progress.replaceChildren(sending);
  const { job } = await server.importFile(body, (sent, all) => sending.showJob({ state: "running", done: sent, total: all }), signal);
  state.begun = true;
  const reading = jobBar(t("Reading the file"));
  progress.replaceChildren(reading);
  return (await ended(server.job, job, reading.showJob)).result;
}
