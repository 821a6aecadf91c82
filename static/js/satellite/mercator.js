/** Size of an area in web map tiles; the server computes the same (core/geo/tilegrid.py). */

const TILE = 256;
const EARTH_M = 2 * Math.PI * 6378137;

/**
 * Cut an area out of the grid of tiles.
 * @param {{north: number, south: number, west: number, east: number}} box degrees
 * @param {number} zoom
 * @returns {{width: number, height: number, tiles: number, metresPerPixel: number}}
 */
export function cut({ north, south, west, east }, zoom) {
  const [left, top] = pixel(north, west, zoom);
  const [right, bottom] = pixel(south, west > east ? east + 360 : east, zoom);
  const [width, height] = [Math.max(right - left, 1), Math.max(bottom - top, 1)];
  const count = (from, size) => Math.floor((from + size - 1) / TILE) - Math.floor(from / TILE) + 1;
  const middle = ((north + south) / 2) * (Math.PI / 180);
  const metresPerPixel = (Math.cos(middle) * EARTH_M) / (TILE * 2 ** zoom);
  return { width, height, tiles: count(left, width) * count(top, height), metresPerPixel };
}

function pixel(lat, lon, zoom) {
  const size = TILE * 2 ** zoom;
  const sine = Math.sin((lat * Math.PI) / 180);
  const x = ((lon + 180) / 360) * size;
  const y = (0.5 - Math.log((1 + sine) / (1 - sine)) / (4 * Math.PI)) * size;
  return [Math.floor(x + 0.5), Math.floor(y + 0.5)];
}
