/** Forms with `data-confirm` ask before they are sent; without scripts they are just sent. */

import { queryAll } from "./dom.js";
import { confirmDialog } from "./dialogs.js";

for (const form of queryAll("form[data-confirm]", HTMLFormElement)) {
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const { confirm: title, confirmText: text, confirmAction: action } = form.dataset;
    if (await confirmDialog({ title, text, action, danger: true })) form.submit();
  });
}
