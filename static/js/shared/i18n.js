/**
 * Texts in the language of the page. The catalogue is embedded in the page (`#i18n`); missing texts stay English.
 */

const { language, plurals, messages } = JSON.parse(document.getElementById("i18n").textContent);
const rules = new Intl.PluralRules(language);

/** Language of the page, for dates and numbers. */
export const locale = language;

/**
 * Translate.
 * @param {string} text English, with `{name}` where a value goes
 * @param {Object<string, *>} [values]
 * @returns {string}
 */
export function t(text, values = {}) {
  return fill(messages[text] || text, values);
}

/**
 * Translate a text that depends on a number.
 * @param {string} one English, for one
 * @param {string} many English, for any other number
 * @param {number} n also the value of `{n}`
 * @param {Object<string, *>} [values]
 * @returns {string}
 */
export function tn(one, many, n, values = {}) {
  const forms = messages[one];
  const form = Array.isArray(forms) ? forms[plurals.indexOf(rules.select(n))] || forms.at(-1) : n === 1 ? one : many;
  return fill(form, { n: n.toLocaleString(language), ...values });
}

/** "Label: value" with the punctuation of the language: French has a space before the colon. */
export function labelled(label, value) {
  return t("{label}: {value}", { label, value });
}

/**
 * Format a duration, roughly.
 * @param {number} seconds
 * @returns {string}
 */
export function duration(seconds) {
  if (seconds < 90) return tn("{n} second", "{n} seconds", Math.max(1, Math.round(seconds)));
  if (seconds < 5400) return tn("{n} minute", "{n} minutes", Math.round(seconds / 60));
  return tn("{n} hour", "{n} hours", Math.round(seconds / 3600));
}

/**
 * Format a time in the past.
 * @param {string} when ISO 8601
 * @returns {string}
 */
export function moment(when) {
  return new Date(when).toLocaleString(language, { dateStyle: "medium", timeStyle: "short" });
}

function fill(text, values) {
  return text.replace(/\{(\w+)\}/g, (whole, name) => (name in values ? String(values[name]) : whole));
}
