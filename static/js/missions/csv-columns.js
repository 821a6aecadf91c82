/** What the columns of a table with poses and objects can hold. */

import { t } from "../shared/i18n.js";

/** @type {import("../shared/column-choice.js").Field[]} */
export const POSE_COLUMNS = [
  { name: "time", label: () => t("Time"), units: ["s", "ms", "us", "ns"], usual: /^(time|timestamp|t|stamp|datetime|utc)(_s)?$/i },
  { name: "lat", label: () => t("Latitude"), units: ["deg", "rad", "e7"], usual: /^(gps_)?lat(itude)?(_deg)?$/i },
  { name: "lon", label: () => t("Longitude"), units: ["deg", "rad", "e7"], usual: /^(gps_)?(lon|lng|long|longitude)(_deg)?$/i },
  { name: "height", label: () => t("Height"), units: ["m", "ft"], usual: /^(height|altitude|alt|ele|elevation)(_m)?$/i },
  { name: "heading", label: () => t("Heading"), units: ["deg", "rad"], usual: /^(heading|course|bearing|hdg)(_deg)?$/i },
  { name: "x", label: () => t("x, forward"), units: ["m", "mm"], usual: /^(pos_)?x(_m)?$/i },
  { name: "y", label: () => t("y, to the left"), units: ["m", "mm"], usual: /^(pos_)?y(_m)?$/i },
  { name: "yaw", label: () => t("Yaw"), units: ["rad", "deg"], usual: /^(yaw|theta)(_rad)?$/i },
  { name: "id", label: () => t("Object"), units: [], usual: /^(object_)?id$/i },
  { name: "class", label: () => t("Class"), units: [], usual: /^(class|kind|label)$/i },
];
