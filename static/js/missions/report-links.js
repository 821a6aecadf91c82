/** Links to reports of a mission, with the time zone and the notation of positions of the viewer. */

import { queryAll } from "../shared/dom.js";
import { onPositionForm, positionForm } from "../shared/map/positions.js";

/** Complete the links, also once another notation is chosen. */
export function connectReportLinks() {
  const zone = new Intl.DateTimeFormat().resolvedOptions().timeZone || "UTC";
  const complete = () => {
    for (const link of queryAll('a[href*="/export.report."]', HTMLAnchorElement)) {
      link.search = new URLSearchParams({ zone, positions: positionForm() }).toString();
    }
  };
  onPositionForm(complete);
  complete();
}
