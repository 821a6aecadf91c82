/** Connects what concerns drawings on the pages of a mission, for members and visitors. */

import { DrawingLayer } from "./drawing-layer.js";
import { showDrawings } from "./drawing-panel.js";
import { DrawingStore } from "./drawing-store.js";
import { connectSketch } from "./sketch.js";

/**
 * Show the drawings; call before the layer of the tracks is added, which is drawn over them.
 * @param {import("../mission-store.js").MissionStore} store
 * @param {import("../mission-view.js").MissionView} view
 */
export function connectDrawings(store, view) {
  const drawings = new DrawingStore(store);
  view.add(new DrawingLayer(drawings, view));
  if (drawings.canEdit) connectSketch(drawings, view);
  showDrawings(drawings, (points) => {
    const [lats, lons] = [points.map(([lat]) => lat), points.map(([, lon]) => lon)];
    if (view.ground) view.show({ south: Math.min(...lats), west: Math.min(...lons), north: Math.max(...lats), east: Math.max(...lons) });
  });
}
