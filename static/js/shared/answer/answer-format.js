/** Formats colours, numbers and angles of an answer for display. */

/** Colours of the pictures: `scale` and `text` by percent, `inlier`, `outlier`, `ink`, `truth`. */
export const colours = JSON.parse(document.getElementById("colours").textContent);

/** Fill and text colour of a probability. @param {number} probability 0 to 1 */
export function probabilityColours(probability) {
  const percent = Math.round(Math.min(Math.max(probability, 0), 1) * 100);
  return { fill: colours.scale[percent], text: colours.text[percent] };
}
