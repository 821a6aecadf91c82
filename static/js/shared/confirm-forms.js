/** Forms with `data-confirm` ask before they are sent; where scripts are off, they are just sent. */

import { confirmDialog } from "./dialogs.js";

for (const form of document.querySelectorAll("form[data-confirm]")) {
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    const { confirm: title, confirmText: text, confirmAction: action } = form.dataset;
    if (await confirmDialog({ title, text, action, danger: true })) form.submit();
  });
}
