/**
 * Forms with `data-passkey`, `create` or `get`: the browser makes or uses a passkey, and the form sends its answer.
 */

import { byId, queryAll } from "../shared/dom.js";
import { t } from "../shared/i18n.js";
import { toast } from "../shared/toast.js";

const options = JSON.parse(byId("passkey-options").textContent);
const [form] = queryAll("form[data-passkey]", HTMLFormElement);

form.addEventListener("submit", async (event) => {
  event.preventDefault();
  await run();
});
if (form.dataset.passkey === "get" && !form.dataset.failed) run({ quiet: true });

async function run({ quiet = false } = {}) {
  try {
    byId("passkey-answer", HTMLInputElement).value = JSON.stringify(await answer());
  } catch (error) {
    // a browser that wants a press of the button first refuses in the same way as a person who cancels
    if (!quiet) toast(words(error), { kind: "error" });
    return;
  }
  form.submit();
}

async function answer() {
  if (!window.PublicKeyCredential?.parseCreationOptionsFromJSON) throw new Error("old");
  const made = form.dataset.passkey === "create"
    ? await navigator.credentials.create({ publicKey: PublicKeyCredential.parseCreationOptionsFromJSON(options) })
    : await navigator.credentials.get({ publicKey: PublicKeyCredential.parseRequestOptionsFromJSON(options) });
  return /** @type {PublicKeyCredential} */ (made).toJSON();
}

/** @param {Error} error */
function words(error) {
  if (error.name === "InvalidStateError") return t("This device has a passkey for this account already.");
  if (error.name === "NotAllowedError") return t("No passkey was given: try again, or use another device.");
  return t("This browser cannot do this: it needs passkeys and https.");
}
