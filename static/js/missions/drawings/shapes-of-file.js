/** Polygons, lines and points of a GeoJSON or KML file, to be added as drawings. */

import { t } from "../../shared/i18n.js";

const MOST_BYTES = 5_000_000;
const KINDS = { Polygon: "area", LineString: "line", Point: "marker" };

/**
 * Read the shapes of a file. Holes of polygons are left out: an area is one outline.
 * @param {File} file
 * @returns {Promise<Array<{kind: string, name: string, points: Array<[number, number]>}>>}
 */
export async function shapesOf(file) {
  if (file.size > MOST_BYTES) throw new Error(t("The file is larger than {n} MB.", { n: MOST_BYTES / 1e6 }));
  const text = await file.text();
  const found = text.trimStart().startsWith("<") ? shapesOfKml(text) : shapesOfGeoJson(text);
  if (!found.length) throw new Error(t("The file has no polygon, line or point."));
  return found.map((shape, n) => ({ ...shape, name: shape.name || `${file.name.replace(/\.[^.]*$/, "")} ${n + 1}` }));
}

/** @param {string} text */
function shapesOfGeoJson(text) {
  let document;
  try {
    document = JSON.parse(text);
  } catch {
    throw new Error(t("The file is neither GeoJSON nor KML."));
  }
  const features = Array.isArray(document?.features) ? document.features : [document];
  return features.flatMap((feature) => geometryShapes(feature?.geometry || feature, String(feature?.properties?.name ?? "")));
}

function geometryShapes(geometry, name) {
  const { type, coordinates, geometries } = geometry || {};
  if (Array.isArray(geometries)) return geometries.flatMap((inner) => geometryShapes(inner, name));
  if (!Array.isArray(coordinates)) return [];
  if (type?.startsWith("Multi")) return coordinates.flatMap((part) => geometryShapes({ type: type.slice(5), coordinates: part }, name));
  if (!KINDS[type]) return [];
  const places = type === "Polygon" ? coordinates[0] : type === "Point" ? [coordinates] : coordinates;
  return [{ kind: KINDS[type], name, points: (places || []).map(([lon, lat]) => [lat, lon]) }];
}

/** @param {string} text */
function shapesOfKml(text) {
  const page = new DOMParser().parseFromString(text, "application/xml");
  if (page.querySelector("parsererror")) throw new Error(t("The file is neither GeoJSON nor KML."));
  const marks = [...page.getElementsByTagNameNS("*", "Placemark")];
  return marks.flatMap((mark) => {
    const name = mark.getElementsByTagNameNS("*", "name")[0]?.textContent.trim() || "";
    return Object.entries(KINDS).flatMap(([type, kind]) => [...mark.getElementsByTagNameNS("*", type)].map((shape) => {
      const rows = shape.getElementsByTagNameNS("*", "coordinates")[0]?.textContent.trim().split(/\s+/) || [];
      return { kind, name, points: rows.map((row) => row.split(",").map(Number)).map(([lon, lat]) => [lat, lon]) };
    }));
  });
}
