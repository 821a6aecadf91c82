/** The dialog that reads a file into a mission: a track, a recording of a robot, a table. */

import { columnChoice } from "../shared/column-choice.js";
import { busy, errorLine, field, openDialog } from "../shared/dialogs.js";
import { h, icon } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { POSE_COLUMNS } from "./csv-columns.js";
import { endpointsOf } from "./endpoints.js";
import { sourceName } from "./format.js";
import { ended, jobBar } from "./job-progress.js";

/** What the file dialog offers. */
export const ACCEPT = ".bag,.mcap,.db3,.gpx,.tcx,.fit,.igc,.geojson,.json,.nmea,.nma,.kml,.kmz,.csv,.txt,.tum,.kitti,.zip,.log";
const SOURCES = ["gps", "odometry", "visual", "manual"];

/**
 * Ask for a file and import it.
 * @param {Object} what
 * @param {?File} [what.file] chosen already
 * @param {function(File): Promise<number>} what.mission gives the mission that the file goes into, made if need be
 * @param {Array<Node>} [what.more] fields in front
 * @param {function(number, Object): void} what.done called with the mission and the job's result
 */
export function importDialog({ file = null, mission, more = [], done }) {
  const input = h("input", { class: "input", type: "file", accept: ACCEPT, "data-testid": "track-file" });
  const source = h("select", { class: "select" },
    h("option", { value: "" }, t("as in the file")), ...SOURCES.map((name) => h("option", { value: name }, sourceName(name))));
  const least = h("input", { class: "input", placeholder: "0.00001", autocomplete: "off", inputmode: "text" });
  const columns = columnChoice(POSE_COLUMNS, ({ name }) => /\.(csv|tsv)$/i.test(name));
  const error = errorLine();
  const progress = h("div", { "aria-live": "polite" });
  const send = h("button", { class: "button button--primary", type: "button", "data-testid": "import-start" }, icon("upload"), t("Import"));
  const about = t("Bags of ROS 1 and ROS 2, MCAP, GPX, TCX, FIT, IGC, NMEA, KML, KMZ, GeoJSON, TUM, KITTI and CSV.");
  const known = h("p", { class: "mi-file" }, icon("route"), file?.name);
  const options = h("details", {}, h("summary", {}, t("Options")), h("div", { class: "stack" },
    field(t("Source of the positions"), source),
    field(t("Skip points that moved less than"), least, t("Degrees, or metres such as 0.5m; 0 keeps every point. The distance always includes every point."))));
  const dialog = openDialog(t("Import a track"), [
    file ? known : field(t("File"), input, about), ...more, columns.element, options, progress, error,
  ], { actions: [send] });
  const chosen = () => file || input.files[0];
  input.addEventListener("change", () => columns.look(chosen()));
  if (file) columns.look(file);
  const abort = new AbortController();
  dialog.addEventListener("close", () => abort.abort());

  const run = async () => {
    error.show(null);
    if (!chosen()) return error.show({ message: t("Choose a file first.") });
    try {
      const id = await mission(chosen());
      const fields = { source: source.value, min_move: least.value.trim(), columns: columns.value() };
      const result = await sendFile({ id, file: chosen(), fields, progress, signal: abort.signal });
      dialog.close();
      done(id, result);
    } catch (problem) {
      progress.replaceChildren();
      if (problem.name !== "AbortError") error.show(problem);
    }
    return null;
  };
  send.addEventListener("click", () => busy(send, run));
}

async function sendFile({ id, file, fields, progress, signal }) {
  const server = endpointsOf(id);
  const body = new FormData();
  body.append("file", file, file.name);
  for (const [name, value] of Object.entries(fields)) if (value) body.append(name, value);
  const sending = jobBar(t("Sending the file..."));
  progress.replaceChildren(sending);
  const { job } = await server.importFile(body, (sent, all) => sending.showJob({ state: "running", done: sent, total: all }), signal);
  const reading = jobBar(t("Reading the file"));
  progress.replaceChildren(reading);
  return (await ended(server.job, job, reading.showJob)).result;
}
