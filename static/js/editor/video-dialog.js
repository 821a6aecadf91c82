/** The dialog to add photos of a video: its file is uploaded, then a job cuts it into sharp, spread frames. */

import { ACCEPTED } from "../shared/accepted.js";
import { errorLine, field, openDialog } from "../shared/dialogs.js";
import { h } from "../shared/dom.js";
import { sizeText } from "../shared/format.js";
import { t } from "../shared/i18n.js";
import { sendInChunks } from "../shared/send-chunks.js";
import { toast } from "../shared/toast.js";
import { fingerprint } from "../shared/uploads.js";

/**
 * Open the dialog.
 * @param {{server: Object, refresh: function(): Promise<void>}} page
 */
export async function videoDialog({ server, refresh }) {
  const error = errorLine();
  const intro = h("p", { class: "soft" }, t("The sharpest frame of each new view becomes a photo of the map, with its time, and its position where that was recorded."));
  const here = await server.videos().catch((problem) => ({ problem }));
  if (here.problem || !here.available) {
    const missing = here.problem ? error : h("p", { "data-testid": "video-missing" }, t("This server cannot read videos. Its admin can install what is missing: {command}", { command: here.install }));
    openDialog(t("Photos from a video"), [intro, missing]);
    if (here.problem) error.show(here.problem);
    return;
  }
  const clip = h("input", { class: "input", type: "file", accept: ACCEPTED.videos, "data-testid": "video-file" });
  const track = h("input", { class: "input", type: "file", accept: ACCEPTED.tracks_of_videos, "data-testid": "video-track" });
  const spread = h("select", { class: "select", "data-testid": "video-spread" },
    h("option", { value: 25 }, t("usual: a quarter of the view apart")),
    h("option", { value: 10 }, t("many: they overlap more")),
    h("option", { value: 50 }, t("few: half a view apart")));
  const starts = h("input", { class: "input", placeholder: "2026-05-01T10:00:00Z", maxlength: 40 });
  const fov = h("input", { class: "input", type: "number", min: 1, max: 179, step: "any", inputmode: "decimal" });
  const bar = h("progress", { class: "progress", value: 0, max: 1, "aria-label": t("Sending the video") });
  const sent = h("p", { class: "small soft", role: "status" });
  const sending = h("div", { class: "stack stack--tight", hidden: true }, bar, sent);
  const add = h("button", { class: "button button--primary", type: "button", disabled: true, "data-testid": "video-add" }, t("Add"));
  const dialog = openDialog(t("Photos from a video"), [
    intro,
    field(t("Video"), clip, t("At most {size}", { size: sizeText(here.most_mb * 1e6) })),
    field(t("Its track (GPX or SRT), if it is a file of its own"), track),
    field(t("Photos"), spread),
    h("details", {}, h("summary", {}, t("If the video does not say it")), h("div", { class: "stack" },
      field(t("When it begins"), starts),
      field(t("Horizontal field of view, degrees"), fov))),
    sending,
    error,
  ], { actions: [add] });
  const stop = new AbortController();
  dialog.addEventListener("close", () => stop.abort());
  clip.addEventListener("change", () => {
    error.show(null);
    add.disabled = !clip.files[0];
  });

  /** Send a file; one that was sent in part before is continued. @param {File} file @returns {Promise<string>} its id */
  const send = async (file) => {
    let id = "";
    await sendInChunks(file, {
      begin: async () => {
        const begun = await server.beginUpload({ name: file.name, size_bytes: file.size, fingerprint: fingerprint(file), beside: [] });
        ({ id } = begun);
        return begun;
      },
      sendChunk: server.sendChunk,
      signal: stop.signal,
      onProgress: (bytes) => {
        bar.value = bytes / file.size;
        sent.textContent = t("{sent} of {size} sent", { sent: sizeText(bytes), size: sizeText(file.size) });
      },
    });
    return id;
  };

  add.addEventListener("click", async () => {
    const inputs = [clip, track, spread, starts, fov, add];
    if (!fov.reportValidity()) return;
    error.show(null);
    for (const one of inputs) one.disabled = true;
    sending.hidden = false;
    try {
      const wish = {
        track: track.files[0] ? await send(track.files[0]) : null,
        clip: await send(clip.files[0]),
        spread: Number(spread.value),
        starts: starts.value.trim() || null,
        fov_deg: Number.isFinite(fov.valueAsNumber) ? fov.valueAsNumber : null,
      };
      await server.cutVideo(wish);
      dialog.close();
      await refresh();
      toast(t("The video is being cut; its photos appear when that is done."));
    } catch (problem) {
      if (!stop.signal.aborted) error.show(problem);
      sending.hidden = true;
      for (const one of inputs) one.disabled = false;
    }
  });
}
