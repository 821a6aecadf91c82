/** What an import proposes from the contents of files: the map that the tracks are on, and the name of the mission. */

const LONGEST_NAME = 120;
/** The reader of GPX numbers tracks and routes, before their names. */
const NUMBERED = /^(?:track|route) \d+ (.+)$/;

/** @typedef {[number, number, number, number]} Box south, west, north, east, degrees */

/**
 * The smallest map whose image holds all tracks; null without one.
 * @template {{box: ?Box}} Known
 * @param {Known[]} maps
 * @param {Array<{frame: string, extent: Object}>} sources of files, as returned by the server
 * @returns {?Known}
 */
export function coveringMap(maps, sources) {
  const placed = sources.filter(({ frame }) => frame === "earth");
  if (!placed.length) return null;
  const holds = ([south, west, north, east]) => placed.every(({ extent }) =>
    extent.south >= south && extent.west >= west && extent.north <= north && extent.east <= east);
  const size = ({ box: [south, west, north, east] }) => (north - south) * (east - west);
  return maps.filter(({ box }) => box && holds(box)).sort((a, b) => size(a) - size(b))[0] ?? null;
}

/** The name of the only track in a file, or else that of the file. @param {{name: string, contents: ?Object}} file */
export function titleOf({ name, contents }) {
  const titles = new Set(contents?.sources.map(({ track }) => NUMBERED.exec(track)?.[1]));
  const [title] = titles.size === 1 ? titles : [];
  return (title || name.replace(/\.\w+$/, "") || name).slice(0, LONGEST_NAME);
}
