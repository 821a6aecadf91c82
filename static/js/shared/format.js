/** Formats times, sizes and accuracies in the language of the page. */

import { duration, locale, t } from "./i18n.js";

const WINDS = 8;
const clock = new Intl.DateTimeFormat(locale, { dateStyle: "medium", timeStyle: "medium" });

/** A time as the camera's clock showed it, without conversion of the time zone. @param {string} iso */
export function clockText(iso) {
  const parsed = new Date(iso.replace(/(Z|[+-]\d\d:?\d\d)$/, ""));
  return Number.isNaN(parsed.getTime()) ? iso : clock.format(parsed);
}

/** The remaining time. @param {number} seconds */
export function leftText(seconds) {
  return seconds < 5 ? t("a few seconds left") : t("{time} left", { time: duration(seconds) });
}

/** A file size. @param {number} bytes */
export function sizeText(bytes) {
  const number = (value) => value.toLocaleString(locale, { maximumFractionDigits: value < 10 ? 1 : 0 });
  if (bytes < 1e6) return `${number(Math.max(bytes / 1e3, 0.1))} kB`;
  return bytes < 1e9 ? `${number(bytes / 1e6)} MB` : `${number(bytes / 1e9)} GB`;
}

/** The accuracy of a position. @param {number} metres */
export function accuracyText(metres) {
  return `${(metres < 10 ? Number(metres.toFixed(1)) : Math.round(metres)).toLocaleString(locale)}\u00a0m`;
}

/** The accuracy of a position, in metres if the scale is known. @param {number} pixels @param {?number} metresPerPixel */
export function offText(pixels, metresPerPixel) {
  return metresPerPixel ? accuracyText(Math.max(0.1, pixels * metresPerPixel)) : t("{n} px", { n: Math.max(1, Math.round(pixels)) });
}

/** A length in metres with three significant digits; 0 below a millimetre. */
export function metresText(value) {
  return value < 0.001 ? "0" : Number(value.toPrecision(3)).toLocaleString(locale, { maximumSignificantDigits: 3 });
}

/** Whether an address works only on the computer itself (loopback). @param {string} address of a page */
export function isLoopback(address) {
  const { hostname } = new URL(address);
  return hostname === "[::1]" || /^(127(\.\d+){3}|(.*\.)?localhost)$/.test(hostname);
}

/** A number rounded to the given digits. */
export function numberText(value, digits = 0) {
  return value.toLocaleString(locale, { maximumFractionDigits: digits });
}

/** A length: in metres if the map has a scale, else in pixels. */
export function lengthText(metres, pixels) {
  if (metres === null || metres === undefined) return t("{n} px", { n: numberText(pixels, pixels < 10 ? 1 : 0) });
  return t("{n} m", { n: numberText(metres, metres < 10 ? 1 : 0) });
}

/** A heading with the name of its direction. @param {number} degrees clockwise from north */
export function headingText(degrees) {
  const names = [t("north"), t("north-east"), t("east"), t("south-east"), t("south"), t("south-west"), t("west"), t("north-west")];
  const turned = ((degrees % 360) + 360) % 360;
  return t("{n}° ({wind})", { n: Math.round(turned) % 360, wind: names[Math.round((turned / 360) * WINDS) % WINDS] });
}

/** A probability in percent; "< 1 %" and "> 99 %" near the ends. */
export function percentText(probability) {
  const percent = probability * 100;
  if (percent > 0 && percent < 1) return "< 1\u00a0%";
  if (percent < 100 && percent > 99) return "> 99\u00a0%";
  return `${Math.round(percent)}\u00a0%`;
}
