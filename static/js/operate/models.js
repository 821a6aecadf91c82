/** The owner's page of models: sends a chosen file, which the server checks, and shows the new state. */

import { api } from "../shared/api.js";
import { queryAll } from "../shared/dom.js";
import { toastError } from "../shared/toast.js";

for (const input of queryAll("input[data-upload]", HTMLInputElement)) {
  input.addEventListener("change", () => send(input));
}

async function send(input) {
  const file = input.files?.[0];
  if (!file) return;
  input.disabled = true;
  try {
    await api(`/models/${encodeURIComponent(input.dataset.upload ?? "")}`, {
      method: "PUT", body: file, headers: { "Content-Type": "application/octet-stream" },
    });
    location.reload();
  } catch (error) {
    toastError(error);
    input.value = "";
    input.disabled = false;
  }
}
