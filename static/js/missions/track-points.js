/** Points of a track, as received and in coordinates of the ground. */

const EARTH_M = 6371008.8;
const RADIANS = Math.PI / 180;

/**
 * A line of points `[number, time_s, lat, lon, heading | null]` in the order of their numbers. `gaps`: indices of
 * points that are not joined to the previous one.
 * Columns: `number`, `time` (Unix s), `lat`, `lon`, `heading` (NaN: unknown), `speed` (m/s, from the point before),
 * `x` and `y` (flat coordinates of the ground).
 */
export class TrackPoints {
  /** @param {{points: Array<Array<number>>, gaps: number[]}} received @param {Object} ground */
  constructor({ points, gaps }, ground) {
    this.ground = ground;
    this.gaps = new Set(gaps);
    /** @type {number[]} */
    this.number = [];
    /** @type {number[]} */
    this.time = [];
    /** @type {number[]} */
    this.lat = [];
    /** @type {number[]} */
    this.lon = [];
    /** @type {number[]} */
    this.heading = [];
    /** @type {number[]} */
    this.speed = [];
    /** @type {number[]} */
    this.x = [];
    /** @type {number[]} */
    this.y = [];
    this.append(points);
  }

  get length() {
    return this.number.length;
  }

  /** Number of the last pose. */
  get last() {
    return this.length ? this.number[this.length - 1] : -1;
  }

  /** Append points, skipping known ones. */
  append(points) {
    for (const [number, time, lat, lon, heading] of points) {
      if (number <= this.last) continue;
      const before = this.length - 1;
      this.number.push(number);
      this.time.push(time);
      this.lat.push(lat);
      this.lon.push(lon);
      this.heading.push(heading ?? NaN);
      this.speed.push(before < 0 || this.gaps.has(before + 1) ? NaN : this._speed(before, time, [lat, lon]));
      this._project(lat, lon);
    }
  }

  /** Convert all points to another ground. */
  setGround(ground) {
    if (this.ground === ground) return;
    this.ground = ground;
    this.x = [];
    this.y = [];
    for (let n = 0; n < this.length; n += 1) this._project(this.lat[n], this.lon[n]);
  }

  /** Index of the last point that is not later than a time; -1 before the first. */
  indexAt(time) {
    let [low, high] = [0, this.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.time[middle] <= time) low = middle + 1;
      else high = middle;
    }
    return low - 1;
  }

  /**
   * Pose of the robot at a time, interpolated between points.
   * @returns {?{x: number, y: number, lat: number, lon: number, heading: number, speed: number, gap: number}} `gap`: seconds between
   *   the two points; null before the first
   */
  at(time) {
    const n = this.indexAt(time);
    if (n < 0) return null;
    const next = Math.min(n + 1, this.length - 1);
    const gap = this.time[next] - this.time[n];
    const share = gap > 0 ? Math.min((time - this.time[n]) / gap, 1) : 0;
    const mixed = (column) => column[n] + (column[next] - column[n]) * share;
    return {
      x: mixed(this.x), y: mixed(this.y), lat: mixed(this.lat), lon: mixed(this.lon),
      heading: this.headingAt(n), speed: this.speed[next], gap: next > n && !this.gaps.has(next) ? gap : Infinity,
    };
  }

  /** Heading of a point; if the robot sent none, the direction to the next point. */
  headingAt(n) {
    if (Number.isFinite(this.heading[n])) return this.heading[n];
    const [from, to] = n + 1 < this.length && !this.gaps.has(n + 1) ? [n, n + 1] : [n - 1, n];
    if (from < 0) return NaN;
    const east = (this.lon[to] - this.lon[from]) * Math.cos(this.lat[from] * RADIANS);
    return Math.atan2(east, this.lat[to] - this.lat[from]) / RADIANS;
  }

  _project(lat, lon) {
    // before a ground is chosen; `setGround` converts them later
    const [x, y] = this.ground?.flat(lat, lon) || [NaN, NaN];
    this.x.push(x);
    this.y.push(y);
  }

  _speed(before, time, to) {
    const seconds = time - this.time[before];
    if (seconds <= 0) return NaN;
    return metresBetween([this.lat[before], this.lon[before]], to) / seconds;
  }
}

/** Distance on a sphere: for speeds and labels, not for the length of a track. */
export function metresBetween([latA, lonA], [latB, lonB]) {
  const [a, b] = [latA * RADIANS, latB * RADIANS];
  const [u, v] = [Math.sin((b - a) / 2), Math.sin(((lonB - lonA) * RADIANS) / 2)];
  return 2 * EARTH_M * Math.asin(Math.sqrt(Math.min(1, u * u + Math.cos(a) * Math.cos(b) * v * v)));
}
