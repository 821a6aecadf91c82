/** Parts of every page: menus, the switches of theme and positions, the offline notice. */

import { closeMenus, h, metaOf } from "./dom.js";
import { t } from "./i18n.js";
import { connectJobs } from "./jobs-menu.js";
import { connectPositions } from "./map/positions.js";
import { connectSharing } from "./share-map.js";
import { connectTerms } from "./term.js";
import { connectTheme } from "./theme.js";

/** Room for the mark that there are more tabs, as in the style sheet. */
const MORE_PX = 28;

closeMenus(document);
connectTheme(document.body);
connectPositions();
connectCopyButtons();
connectSharing();
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

/** Reload pictures that could not be loaded while offline. */
function loadBrokenImages() {
  for (const image of document.images) {
    if (image.complete && !image.naturalWidth && image.src) image.setAttribute("src", image.src);
  }
}

/** Run after loading, so as not to slow down the page. */
function whenLoaded(run) {
  if (document.readyState === "complete") run();
  else addEventListener("load", run, { once: true });
}

/** Register the service worker, which caches pages of one account for offline use. Needs https or localhost. */
async function workOffline() {
  const account = metaOf("expmap-account")?.content;
  if (account === undefined || !navigator.serviceWorker) return;
  const known = account ? await navigator.serviceWorker.register("/sw.js") : await navigator.serviceWorker.getRegistration();
  if (!known) return;
  const { active } = await navigator.serviceWorker.ready;
  active.postMessage({ account, page: location.pathname });
}

/** If not all tabs fit, scroll to the current one, mark where there are more, and hide those that would be cut off. */
function connectTabs() {
  const tabs = document.querySelector(".tabs");
  if (!tabs) return;
  const mark = () => {
    const [before, after] = [tabs.scrollLeft > 1, tabs.scrollLeft + tabs.clientWidth < tabs.scrollWidth - 1];
    const room = tabs.getBoundingClientRect();
    tabs.toggleAttribute("data-before", before);
    tabs.toggleAttribute("data-more", after);
    for (const tab of tabs.children) {
      const { left, right } = tab.getBoundingClientRect();
      tab.toggleAttribute("data-cut", (before && left < room.left + MORE_PX) || (after && right > room.right - MORE_PX));
    }
  };
  mark(); // first, as tabs are wider where they do not fit
  tabs.querySelector("[aria-current=page]")?.scrollIntoView({ block: "nearest", inline: "nearest" });
  tabs.addEventListener("scroll", mark, { passive: true });
  new ResizeObserver(mark).observe(tabs);
}

/** A button with `data-copy` copies the text of the field before it. */
function connectCopyButtons() {
  for (const button of document.querySelectorAll("[data-copy]")) {
    button.addEventListener("click", async () => {
      const field = button.parentElement.querySelector("input");
      field.select();
      // Without https there is no clipboard for scripts: the selected text can be copied by hand.
      if (!navigator.clipboard) return;
      await navigator.clipboard.writeText(field.value);
      button.querySelector("span").textContent = t("Copied");
    });
  }
}
