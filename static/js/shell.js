/** What every page has: menus, the colour switch, the word that the network is away. */

import { closeMenus, h } from "./dom.js";
import { t } from "./i18n.js";
import { connectTheme } from "./theme.js";

closeMenus(document);
connectTheme(document.body);
connectCopyButtons();

const away = h("div", { class: "offline", role: "status", hidden: true }, t("No connection. Trying again..."));
document.body.append(away);
window.addEventListener("expmap:offline", () => (away.hidden = false));
window.addEventListener("expmap:online", () => (away.hidden = true));

/** A button with `data-copy` takes the text of the field before it. */
function connectCopyButtons() {
  for (const button of document.querySelectorAll("[data-copy]")) {
    button.addEventListener("click", async () => {
      const field = button.parentElement.querySelector("input");
      field.select();
      // Without https the browser has no clipboard for scripts: the selected text can be copied by hand.
      if (!navigator.clipboard) return;
      await navigator.clipboard.writeText(field.value);
      button.querySelector("span").textContent = t("Copied");
    });
  }
}
