/**
 * Positions in degrees, minutes and seconds, UTM and MGRS, written as `webapp/core/geo/grids.py` does, and read.
 *
 * Transverse Mercator by Krueger's series in the third flattening (WGS 84, to its fourth power: below 0.001 mm within
 * a zone); latitudes by Karney, "Transverse Mercator with an accuracy of a few nanometers" (2011).
 */

const FLATTENING = 1 / 298.257223563;
const ECCENTRICITY = Math.sqrt(FLATTENING * (2 - FLATTENING));
const N = FLATTENING / (2 - FLATTENING);
/** Radius of the rectifying sphere, with the scale on the central meridian. */
const RADIUS_M = (0.9996 * 6378137 * (1 + N ** 2 / 4 + N ** 4 / 64)) / (1 + N);
const TO_PLANE = [
  N / 2 - (2 / 3) * N ** 2 + (5 / 16) * N ** 3 + (41 / 180) * N ** 4,
  (13 / 48) * N ** 2 - (3 / 5) * N ** 3 + (557 / 1440) * N ** 4,
  (61 / 240) * N ** 3 - (103 / 140) * N ** 4,
  (49561 / 161280) * N ** 4,
];
const FROM_PLANE = [
  N / 2 - (2 / 3) * N ** 2 + (37 / 96) * N ** 3 - (1 / 360) * N ** 4,
  (1 / 48) * N ** 2 + (1 / 15) * N ** 3 - (437 / 1440) * N ** 4,
  (17 / 480) * N ** 3 - (37 / 840) * N ** 4,
  (4397 / 161280) * N ** 4,
];
const FALSE_EASTING_M = 500_000;
const FALSE_NORTHING_M = 10_000_000; // south of the equator
const [SOUTH_END, NORTH_END] = [-80, 84];
const BAND_DEG = 8;
const BANDS = "CDEFGHJKLMNPQRSTUVWX";
/** Letters of the 100 km columns, for zones 1, 2 and 3, and repeated every three zones. */
const COLUMNS = ["ABCDEFGH", "JKLMNPQR", "STUVWXYZ"];
const ROWS = "ABCDEFGHJKLMNPQRSTUV";
const SQUARE_M = 100_000;
const RADIANS = Math.PI / 180;
/** The middle of a square of 10 km on the edge of a band may be this far outside the band. */
const BAND_EDGE_DEG = 0.1;

/**
 * A position on the UTM grid.
 * @typedef {{zone: number, band: string, easting: number, northing: number}} Utm
 */

/** @param {number[]} place lat, lon @returns {?Utm} null beyond 84 degrees north and 80 degrees south */
export function utmOf([lat, lon]) {
  if (!(lat >= SOUTH_END && lat <= NORTH_END && Number.isFinite(lon))) return null;
  const zone = zoneOf(lat, wrapped(lon));
  const [x, y] = toPlane(lat, wrapped(lon - meridianOf(zone)));
  const millimetres = (metres) => Math.round(metres * 1000) / 1000; // so that a position on a grid line stays on it
  const band = BANDS[Math.min(Math.floor((lat - SOUTH_END) / BAND_DEG), BANDS.length - 1)];
  return { zone, band, easting: millimetres(x + FALSE_EASTING_M), northing: millimetres(y + (lat < 0 ? FALSE_NORTHING_M : 0)) };
}

/** To a metre, such as `33U 558962 5562189`. @param {number[]} place lat, lon @returns {?string} null where there is no UTM */
export function utmText(place) {
  const utm = utmOf(place);
  return utm && `${utm.zone}${utm.band} ${digits(utm.easting, 6)} ${digits(utm.northing, 7)}`;
}

/** The square of a metre, such as `33U WR 58962 62189`. @param {number[]} place lat, lon @returns {?string} null where there is no UTM */
export function mgrsText(place) {
  const utm = utmOf(place);
  if (!utm) return null;
  const { zone, band, easting, northing } = utm;
  const column = COLUMNS[(zone - 1) % 3][Math.floor(easting / SQUARE_M) - 1];
  const row = ROWS[(Math.floor(northing / SQUARE_M) + rowShift(zone)) % ROWS.length];
  return `${zone}${band} ${column}${row} ${digits(easting % SQUARE_M, 5)} ${digits(northing % SQUARE_M, 5)}`;
}

/** Such as `50°12'37.44"N 15°49'30.72"E`. @param {number[]} place lat, lon */
export function dmsText([lat, lon]) {
  return `${sexagesimal(lat)}${lat >= 0 ? "N" : "S"} ${sexagesimal(lon)}${lon >= 0 ? "E" : "W"}`;
}

/**
 * Read a position in any of the forms: `50.08, 14.42`, degrees with letters, minutes and seconds, UTM or MGRS.
 * @param {string} text
 * @returns {?[number, number]} latitude, longitude; null if it is none
 */
export function parsePosition(text) {
  const tidy = text.trim().toUpperCase();
  const place = parseDecimal(tidy) ?? parseDms(tidy) ?? parseUtm(tidy) ?? parseMgrs(tidy);
  return place && Math.abs(place[0]) <= 90 && Math.abs(place[1]) <= 180 ? place : null;
}

/** @returns {?[number, number]} */
function parseDecimal(text) {
  const found = /^(-?\d+(?:\.\d+)?)\s*[,;\s]\s*(-?\d+(?:\.\d+)?)$/.exec(text);
  return found && [Number(found[1]), Number(found[2])];
}

const ANGLE = String.raw`(\d+(?:\.\d+)?)\s*°\s*(?:(\d+(?:\.\d+)?)\s*['′’]\s*)?(?:(\d+(?:\.\d+)?)\s*(?:"|″|”|'')\s*)?`;
const DMS = new RegExp(String.raw`^${ANGLE}([NS])[,;\s]*${ANGLE}([EW])$`);

/** @returns {?[number, number]} */
function parseDms(text) {
  const found = DMS.exec(text);
  if (!found) return null;
  const angle = (first) => {
    const [degrees, minutes, seconds] = found.slice(first, first + 3).map((part) => Number(part ?? 0));
    const value = minutes < 60 && seconds < 60 ? degrees + minutes / 60 + seconds / 3600 : NaN;
    return "SW".includes(found[first + 3]) ? -value : value;
  };
  return [angle(1), angle(5)];
}

/** The letter is a band; N and S are also read as the hemisphere, where the band does not fit. @returns {?[number, number]} */
function parseUtm(text) {
  const found = /^(\d{1,2})\s*([C-HJ-NP-X])[\s,]+(\d{6}(?:\.\d+)?)\s*(?:M?\s*E)?[\s,]+(\d{1,8}(?:\.\d+)?)\s*(?:M?\s*N)?$/.exec(text);
  if (!found) return null;
  const [zone, easting, northing] = [found[1], found[3], found[4]].map(Number);
  const letter = found[2];
  if (zone < 1 || zone > 60) return null;
  const south = letter < "N";
  const place = latLonOf({ zone, easting, northing, south });
  if (isInBand(place, letter)) return place;
  if (letter !== "N" && letter !== "S") return null;
  const inHemisphere = latLonOf({ zone, easting, northing, south: letter === "S" });
  return (letter === "S" ? inHemisphere[0] < 0 && inHemisphere[0] >= SOUTH_END : inHemisphere[0] <= NORTH_END) ? inHemisphere : null;
}

/** The middle of the square, of any size from a metre to 10 km. @returns {?[number, number]} */
function parseMgrs(text) {
  const found = /^(\d{1,2})([C-HJ-NP-X])([A-HJ-NP-Z])([A-HJ-NP-V])(\d{2,10})$/.exec(text.replace(/\s+/g, ""));
  if (!found || found[5].length % 2) return null;
  const [zone, [, , band, columnLetter, rowLetter, numbers]] = [Number(found[1]), found];
  const column = COLUMNS[(zone - 1) % 3]?.indexOf(columnLetter) ?? -1;
  if (zone < 1 || zone > 60 || column < 0) return null;
  const half = numbers.length / 2;
  const step = 10 ** (5 - half);
  const within = (part) => (Number(part) + 0.5) * step;
  const easting = (column + 1) * SQUARE_M + within(numbers.slice(0, half));
  const row = (ROWS.indexOf(rowLetter) - rowShift(zone) + ROWS.length) % ROWS.length;
  for (let northing = row * SQUARE_M + within(numbers.slice(half)); northing < FALSE_NORTHING_M; northing += ROWS.length * SQUARE_M) {
    const place = latLonOf({ zone, easting, northing, south: band < "N" });
    if (isInBand(place, band)) return place;
  }
  return null;
}

/** @param {number[]} place lat, lon @param {string} band */
function isInBand([lat], band) {
  const from = SOUTH_END + BANDS.indexOf(band) * BAND_DEG;
  const to = band === "X" ? NORTH_END : from + BAND_DEG;
  return lat >= from - BAND_EDGE_DEG && lat <= to + BAND_EDGE_DEG;
}

/** With the exceptions for Norway and Svalbard. */
function zoneOf(lat, lon) {
  if (lat >= 56 && lat < 64 && lon >= 3 && lon < 12) return 32;
  if (lat >= 72 && lon >= 0 && lon < 42) return 31 + 2 * Math.floor((lon + 3) / 12);
  return (Math.floor((lon + 180) / 6) % 60) + 1;
}

const meridianOf = (zone) => zone * 6 - 183;
/** In even zones the letters of the rows are shifted by five. */
const rowShift = (zone) => (zone % 2 ? 0 : 5);
const wrapped = (lon) => ((((lon + 180) % 360) + 360) % 360) - 180;
const digits = (metres, count) => String(Math.floor(metres)).padStart(count, "0");

/** Metres east of the central meridian and north of the equator. */
function toPlane(lat, east) {
  const [tau, lambda] = [Math.tan(lat * RADIANS), east * RADIANS];
  const conformal = conformalOf(tau);
  const xi = Math.atan2(conformal, Math.cos(lambda));
  const eta = Math.asinh(Math.sin(lambda) / Math.hypot(conformal, Math.cos(lambda)));
  const sum = (part) => TO_PLANE.reduce((all, factor, n) => all + factor * part(2 * (n + 1)), 0);
  return [
    RADIUS_M * (eta + sum((k) => Math.cos(k * xi) * Math.sinh(k * eta))),
    RADIUS_M * (xi + sum((k) => Math.sin(k * xi) * Math.cosh(k * eta))),
  ];
}

/** @returns {[number, number]} latitude, longitude */
function latLonOf({ zone, easting, northing, south }) {
  const [x, y] = [(easting - FALSE_EASTING_M) / RADIUS_M, (northing - (south ? FALSE_NORTHING_M : 0)) / RADIUS_M];
  const sum = (part) => FROM_PLANE.reduce((all, factor, n) => all + factor * part(2 * (n + 1)), 0);
  const xi = y - sum((k) => Math.sin(k * y) * Math.cosh(k * x));
  const eta = x - sum((k) => Math.cos(k * y) * Math.sinh(k * x));
  const conformal = Math.sin(xi) / Math.hypot(Math.sinh(eta), Math.cos(xi));
  const lon = meridianOf(zone) + Math.atan2(Math.sinh(eta), Math.cos(xi)) / RADIANS;
  return [Math.atan(tangentOf(conformal)) / RADIANS, wrapped(lon)];
}

/** Tangent of the conformal latitude, from that of the latitude. */
function conformalOf(tau) {
  const sigma = Math.sinh(ECCENTRICITY * Math.atanh((ECCENTRICITY * tau) / Math.hypot(1, tau)));
  return tau * Math.hypot(1, sigma) - sigma * Math.hypot(1, tau);
}

/** The inverse of `conformalOf`, by Newton's method. */
function tangentOf(conformal) {
  const rest = 1 - ECCENTRICITY ** 2;
  let tau = conformal / rest;
  for (let n = 0; n < 5; n += 1) {
    const found = conformalOf(tau);
    tau += ((conformal - found) / Math.hypot(1, found)) * ((1 + rest * tau ** 2) / (rest * Math.hypot(1, tau)));
  }
  return tau;
}

function sexagesimal(degrees) {
  const hundredths = Math.round(Math.abs(degrees) * 360_000);
  const [minutes, rest] = [Math.floor(hundredths / 6000), hundredths % 6000];
  return `${Math.floor(minutes / 60)}°${String(minutes % 60).padStart(2, "0")}'${(rest / 100).toFixed(2).padStart(5, "0")}"`;
}
