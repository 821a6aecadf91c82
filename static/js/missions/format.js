/** Formats lengths, speeds, times and names of sources for display. */

import { locale, t } from "../shared/i18n.js";

const clock = new Intl.DateTimeFormat(locale, { dateStyle: "medium", timeStyle: "medium" });
/** Times within a day are written without their date. */
export const DAY_S = 86400;

/** Shorter spans are ignored: many files have the same time at all points. */
export const SHORTEST_S = 1;

const dayTime = new Intl.DateTimeFormat(locale, { timeStyle: "medium" });

/** A number rounded to the given digits. */
export function numberText(value, digits = 0) {
  return value.toLocaleString(locale, { maximumFractionDigits: digits });
}

/** @param {number} metres */
export function lengthText(metres) {
  if (metres >= 1000) return t("{n} km", { n: numberText(metres / 1000, metres < 10000 ? 2 : 1) });
  return t("{n} m", { n: numberText(metres, metres < 10 ? 2 : metres < 100 ? 1 : 0) });
}

/** @param {number} speed metres a second */
export function speedText(speed) {
  return t("{n} m/s", { n: numberText(speed, speed < 10 ? 2 : 1) });
}

/** A share of one, in percent. */
export function percentText(share) {
  return `${numberText(share * 100, share < 0.01 ? 2 : 1)}\u00a0%`;
}

/** A date and time. @param {number} time Unix seconds */
export function clockText(time) {
  return clock.format(new Date(time * 1000));
}

/** A time of day. @param {number} time Unix seconds */
export function timeText(time) {
  return dayTime.format(new Date(time * 1000));
}

const short = new Intl.DateTimeFormat(locale, { dateStyle: "medium", timeStyle: "short" });

/** From when to when, without what both have in common. @param {number} first Unix seconds @param {number} last */
export function recordedText(first, last) {
  return short.formatRange(new Date(first * 1000), new Date(last * 1000));
}

/** A duration as h:mm:ss or m:ss. @param {number} seconds */
export function spanText(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  const pad = (value) => String(value).padStart(2, "0");
  const [hours, minutes] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60];
  return hours ? `${hours}:${pad(minutes)}:${pad(whole % 60)}` : `${minutes}:${pad(whole % 60)}`;
}

/** Name of a source of positions. */
export function sourceName(source) {
  const names = {
    gps: t("GPS"),
    odometry: t("Odometry"),
    visual: t("Visual fixes"),
    fused: t("Corrected"),
    manual: t("Manual"),
  };
  return names[source] || source;
}

/** Name of a track unless people have set one. */
export function usualName({ source, name }) {
  return name ? `${sourceName(source)} · ${name}` : sourceName(source);
}

/** Name of a track. */
export function trackName(track) {
  return track.look?.title || usualName(track);
}
