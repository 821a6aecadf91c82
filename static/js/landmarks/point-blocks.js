/** Unpacks the server's blocks of points: all coordinates, then all colours. */

const BYTES = 10;

/**
 * Unpack a block.
 * @param {ArrayBuffer} buffer
 * @returns {{count: number, steps: Uint16Array, colours: Uint8Array}} four numbers per point: x, y, z and 0;
 *   red, green, blue and the number of photos that see it
 */
export function unpack(buffer) {
  const count = buffer.byteLength / BYTES;
  const packed = new Uint16Array(buffer, 0, 3 * count);
  const steps = new Uint16Array(4 * count); // GPUs read attributes aligned to four bytes fastest
  for (let point = 0; point < count; point += 1) {
    for (let axis = 0; axis < 3; axis += 1) steps[4 * point + axis] = packed[3 * point + axis];
  }
  return { count, steps, colours: new Uint8Array(buffer, 6 * count, 4 * count) };
}

/**
 * Range of heights of most points (3 % to 97 %), over which the colours are spread.
 * @param {Uint16Array} steps
 * @param {number} offset
 * @param {number} scale
 * @returns {number[]}
 */
export function usualHeights(steps, offset, scale) {
  const heights = new Uint16Array(steps.length / 4).map((_, point) => steps[4 * point + 2]).sort();
  if (!heights.length) return [0, 1];
  const at = (share) => offset + scale * heights[Math.floor(share * (heights.length - 1))];
  return [at(0.03), Math.max(at(0.97), at(0.03) + 1e-3)];
}
