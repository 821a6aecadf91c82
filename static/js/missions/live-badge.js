/** Whether a mission is live: not ended, and with recent data. */

import { byId } from "../shared/dom.js";
import { t } from "../shared/i18n.js";

const LIVE_MS = 120_000;
/** A mission without any data for so long was imported, or is over. */
const RECORDING_MS = 24 * 3600_000;

/**
 * Keep the badge up to date.
 * @param {Object} store of the mission
 * @param {function(): boolean} isConnected whether the page receives events
 * @returns {function(): void} updates the badge
 */
export function liveBadge(store, isConnected) {
  const badge = byId("live-state");
  let heard = 0;
  const render = () => {
    const newest = Math.max(0, ...store.mission.tracks.map(({ last_time_s: time }) => (time || 0) * 1000));
    const ended = Boolean(store.mission.ended_at);
    const isLive = isConnected() && !ended && Date.now() - Math.max(heard, newest) < LIVE_MS;
    const isOld = newest > 0 && Date.now() - Math.max(heard, newest) > RECORDING_MS;
    const text = !isConnected() ? t("No connection") : isLive ? t("Live") : ended ? t("Ended") : isOld ? t("Recorded") : t("No recent data");
    badge.className = `badge ${!isConnected() ? "badge--warning" : isLive ? "badge--success mi-live" : ""}`;
    if (badge.textContent !== text) badge.textContent = text;
    byId("follow-part").hidden = ended;
  };
  store.on("poses missed", ({ detail: { key, first } }) => {
    // Times of poses may be old if a recording is replayed; but a further track may be an import, and a corrected one was computed.
    if (!first && store.track(key)?.track.source !== "fused") heard = Date.now();
  });
  store.on("missions grown", render);
  setInterval(render, LIVE_MS / 10);
  render();
  return render;
}
