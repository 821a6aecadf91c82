/** Converts latitude and longitude to map pixels: the inverse of the grid that the server samples. */

const STEPS = 8;
const NEAR_PX = 0.02;
/** Farther outside the image than this fraction of its size, the affine fit is used alone. */
const OUTSIDE = 1;

/** Finds map pixels: an affine estimate, refined iteratively with the grid. */
export class PixelFromLatLon {
  /** @param {import("./coords.js").Georeference} georeference */
  constructor(georeference) {
    this.georeference = georeference;
    this.size = georeference.size;
    this.plane = fit(georeference);
  }

  /**
   * @param {number} lat
   * @param {number} lon
   * @returns {?number[]} null without a georeference
   */
  find(lat, lon) {
    if (!this.plane) return null;
    const { middle, matrix, centre } = this.plane;
    const step = (dLat, dLon) => [matrix[0] * dLat + matrix[1] * dLon, matrix[2] * dLat + matrix[3] * dLon];
    const [dx, dy] = step(lat - middle[0], turned(lon - middle[1]));
    let at = [centre[0] + dx, centre[1] + dy];
    if (this._far(at)) return at;
    for (let n = 0; n < STEPS; n += 1) {
      const there = this.georeference.latLon(at);
      if (!there) return at;
      const [x, y] = step(lat - there[0], turned(lon - there[1]));
      at = [at[0] + x, at[1] + y];
      if (Math.abs(x) + Math.abs(y) < NEAR_PX || this._far(at)) break;
    }
    return at;
  }

  /** @param {number[]} pixel */
  _far([x, y]) {
    const [width, height] = this.size;
    return x < -OUTSIDE * width || y < -OUTSIDE * height || x > (1 + OUTSIDE) * width || y > (1 + OUTSIDE) * height;
  }
}

/** Least-squares affine function from degrees to pixels for the grid, around its mean. */
function fit({ grid, size }) {
  if (!grid) return null;
  const { columns, rows, latlon } = grid;
  const known = latlon.flatMap((place, n) => {
    if (!place) return [];
    const [i, j] = [n % (columns + 1), Math.floor(n / (columns + 1))];
    return [[place[0], turned(place[1] - latlon.find(Boolean)[1]), (i / columns) * size[0], (j / rows) * size[1]]];
  });
  if (known.length < 3) return null;
  const mean = [0, 1, 2, 3].map((axis) => known.reduce((sum, row) => sum + row[axis], 0) / known.length);
  const product = (a, b) => known.reduce((sum, row) => sum + (row[a] - mean[a]) * (row[b] - mean[b]), 0);
  const [aa, ab, bb] = [product(0, 0), product(0, 1), product(1, 1)];
  const determinant = aa * bb - ab * ab;
  if (determinant <= 0) return null;
  const solve = (axis) => {
    const [u, v] = [product(0, axis), product(1, axis)];
    return [(u * bb - v * ab) / determinant, (v * aa - u * ab) / determinant];
  };
  const first = latlon.find(Boolean)[1];
  return { middle: [mean[0], turned(first + mean[1])], centre: [mean[2], mean[3]], matrix: [...solve(2), ...solve(3)] };
}

function turned(degrees) {
  return ((((degrees + 180) % 360) + 360) % 360) - 180;
}
