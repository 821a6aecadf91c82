/** Addresses of tiles, from the template of a service: by zoom, column and row, or by the area, as WMS wants it. */

const HALF_M = Math.PI * 6378137;

/** What a template can name besides {z}, {x} and {y}; Leaflet takes these as options of a layer. */
export const areas = {
  /** West, south, east, north in metres of web Mercator. */
  bbox: (/** @type {Tile} */ tile) => boundsOf(tile).map(String).join(","),
  /** South, west, north, east in degrees: the order of axes of EPSG:4326 in WMS 1.3.0. */
  "bbox-4326": (/** @type {Tile} */ tile) => {
    const [west, south, east, north] = boundsOf(tile).map((metres) => (metres / HALF_M) * 180);
    return [latitude(south), west, latitude(north), east].map(String).join(",");
  },
};

/** @param {string} template @param {Tile} tile */
export function addressOf(template, tile) {
  return template.replaceAll(/\{([zxy]|bbox|bbox-4326)\}/g, (_, name) => (name in areas ? areas[name](tile) : String(tile[name])));
}

/** @typedef {{z: number, x: number, y: number}} Tile */

/** @param {Tile} tile @returns {number[]} west, south, east, north in metres */
function boundsOf({ z, x, y }) {
  const side = (2 * HALF_M) / 2 ** z;
  return [x * side - HALF_M, HALF_M - (y + 1) * side, (x + 1) * side - HALF_M, HALF_M - y * side];
}

/** Latitude of a position between the equator (0) and the edge of the square (180). */
function latitude(y) {
  return (Math.atan(Math.sinh((y / 180) * Math.PI)) * 180) / Math.PI;
}
