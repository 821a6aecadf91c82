/** What every page has: menus, the colour switch, the word that the network is away. */

import { closeMenus, h, metaOf } from "./dom.js";
import { t } from "./i18n.js";
import { connectJobs } from "./jobs-menu.js";
import { connectTerms } from "./term.js";
import { connectTheme } from "./theme.js";

closeMenus(document);
connectTheme(document.body);
connectCopyButtons();
connectTabs();
connectTerms();
whenLoaded(connectJobs);
whenLoaded(() => workOffline().catch((error) => console.info(`no pages without a network: ${error.message}`)));

const fieldLink = metaOf("expmap-account")?.content && h("a", { href: "/field" }, t("Take photos for later"));
const away = h("div", { class: "offline", role: "status", hidden: true }, t("No connection. Trying again..."), " ", fieldLink);
document.body.append(away);
window.addEventListener("expmap:offline", () => (away.hidden = false));
window.addEventListener("expmap:online", () => (away.hidden = true));
for (const back of ["expmap:online", "online"]) window.addEventListener(back, loadBrokenImages);

/** Pictures that could not be loaded while the network was away. */
function loadBrokenImages() {
  for (const image of document.images) {
    if (image.complete && !image.naturalWidth && image.src) image.setAttribute("src", image.src);
  }
}

/** What is kept for later does not slow down the page itself. */
function whenLoaded(run) {
  if (document.readyState === "complete") run();
  else addEventListener("load", run, { once: true });
}

/** Pages open without a network; what is kept for that belongs to one account. Needs https, or this machine. */
async function workOffline() {
  const account = metaOf("expmap-account")?.content;
  if (account === undefined || !navigator.serviceWorker) return;
  const known = account ? await navigator.serviceWorker.register("/sw.js") : await navigator.serviceWorker.getRegistration();
  if (!known) return;
  const { active } = await navigator.serviceWorker.ready;
  active.postMessage({ account, page: location.pathname });
}

/** Where there is no room for all tabs, the current one is in view, and a fading edge says that there are more. */
function connectTabs() {
  const tabs = document.querySelector(".tabs");
  if (!tabs) return;
  const mark = () => tabs.toggleAttribute("data-more", tabs.scrollLeft + tabs.clientWidth < tabs.scrollWidth - 1);
  tabs.querySelector("[aria-current=page]")?.scrollIntoView({ block: "nearest", inline: "nearest" });
  tabs.addEventListener("scroll", mark, { passive: true });
  new ResizeObserver(mark).observe(tabs);
}

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
