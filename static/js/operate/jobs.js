/** The page with the jobs of a map: polls once a second while it is visible and a job is active. */

import { get } from "../shared/api.js";
import { byId } from "../shared/dom.js";
import { isLive, JobList } from "../shared/job-list.js";
import { toastError } from "../shared/toast.js";

const BUSY_MS = 1000;
const IDLE_MS = 5000;

const { map } = JSON.parse(byId("page").textContent);
const list = new JobList(byId("jobs"), { refresh });
let jobs = [];

watch();

async function refresh() {
  ({ jobs } = await get(`/jobs?map=${encodeURIComponent(map)}`));
  byId("no-jobs").hidden = jobs.length > 0;
  list.show(jobs);
}

async function watch() {
  if (!document.hidden) {
    try {
      await refresh();
    } catch (error) {
      if (error.code !== "offline") toastError(error);
      if (error.status >= 400 && error.status < 500) return;
    }
  }
  setTimeout(watch, jobs.some(isLive) ? BUSY_MS : IDLE_MS);
}
