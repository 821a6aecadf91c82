/** The header's menu with the jobs of all maps; its button shows the number of active jobs. */

import { get } from "./api.js";
import { byId } from "./dom.js";
import { t, tn } from "./i18n.js";
import { isLive, JobList } from "./job-list.js";
import { toastError } from "./toast.js";

const OPEN_MS = 1000;
const BUSY_MS = 5000;

/** Connect the menu; pages for visitors have none. It polls only while jobs are active. */
export function connectJobs() {
  const menu = document.getElementById("jobs-menu");
  if (!(menu instanceof HTMLDetailsElement)) return;
  const list = new JobList(byId("jobs-menu-list"), { refresh: () => refresh(), title: "h3", maps: true });
  let timer = null;
  let begun = 0;
  let live = 0;

  const refresh = async () => {
    clearTimeout(timer);
    const { jobs } = await get("/jobs", { patient: false });
    live = jobs.filter(isLive).length;
    sayHowMany(live);
    byId("jobs-menu-none").hidden = jobs.length > 0;
    const pressed = menu.matches(":active");
    if (menu.open && !pressed) list.show(jobs); // do not replace a button that is being pressed
    if (live || pressed) soon();
  };
  const soon = () => (timer = setTimeout(watch, menu.open ? OPEN_MS : BUSY_MS));

  const watch = () => {
    clearTimeout(timer);
    if (document.hidden || !navigator.onLine) return;
    refresh().catch((error) => {
      if (error.code === "offline") live && soon(); // the server may be restarting
      else if (menu.open) toastError(error);
    });
  };

  menu.addEventListener("toggle", () => menu.open && watch());
  document.addEventListener("visibilitychange", watch);
  addEventListener("online", watch);
  addEventListener("expmap:job", () => {
    begun += 1;
    const mine = begun;
    setTimeout(() => mine === begun && watch(), 300); // one request for several jobs that start together
  });
  watch();
}

function sayHowMany(live) {
  const count = byId("jobs-menu-count");
  count.hidden = !live;
  count.textContent = String(live);
  const name = live ? tn("Jobs: {n} active", "Jobs: {n} active", live) : t("Jobs");
  byId("jobs-menu-button").setAttribute("aria-label", name);
  byId("jobs-menu-button").title = name;
}
