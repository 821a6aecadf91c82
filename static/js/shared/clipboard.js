/** Copying text. */

import { toast } from "./toast.js";

/**
 * Copy text to the clipboard; without https there is no clipboard, and the text is shown instead.
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
