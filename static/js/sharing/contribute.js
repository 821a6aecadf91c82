/** Lets a visitor give photos to the map, one after the other, once they agree to what happens with them. */

import { upload } from "../shared/api.js";
import { byId } from "../shared/dom.js";
import { labelled, t } from "../shared/i18n.js";
import { note, sentence } from "../shared/toast.js";

/** @param {string} path of the request */
export function contribute(path) {
  const consent = byId("give-consent", HTMLInputElement);
  const input = byId("give-input", HTMLInputElement);
  const label = byId("give-label");
  const allow = () => {
    input.disabled = !consent.checked;
    label.classList.toggle("is-disabled", !consent.checked);
  };
  consent.addEventListener("change", allow);
  allow();
  input.addEventListener("change", async () => {
    const files = [...input.files];
    input.value = ""; // the same file can be chosen again
    input.disabled = true;
    byId("give-notes").replaceChildren();
    for (const file of files) await send(path, file);
    allow();
  });
}

async function send(path, file) {
  const name = file.name || "photo.jpg";
  const body = new FormData();
  body.append("file", file, name);
  body.append("consent", "true");
  const bar = byId("give-busy", HTMLProgressElement);
  bar.hidden = false;
  try {
    const { found, searching } = await upload(path, { body });
    const where = found ? t("Its place on the map was found.")
      : searching ? t("Its place is looked for when the map is ready.")
        : t("Its place was not found: the owners of the map can look for it.");
    byId("give-notes").append(note("info", labelled(name, t("Thank you. The photo waits for the owners of the map.")), where));
  } catch (error) {
    byId("give-notes").append(note("danger", labelled(name, error.message), error.hint && sentence(error.hint)));
  }
  bar.hidden = true;
}
