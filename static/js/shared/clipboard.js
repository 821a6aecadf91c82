/** Text for other programs. */

import { toast } from "./toast.js";

/**
 * Put text into the clipboard; without https the browser has none, and the text is shown instead.
 * @param {string} text
 * @param {string} confirmation
 */
export async function copy(text, confirmation) {
  try {
    await navigator.clipboard.writeText(text);
    toast(confirmation);
  } catch {
    toast(text);
  }
}
