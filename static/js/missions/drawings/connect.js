/** Connects what concerns drawings on the pages of a mission, for members and visitors. */

import { DrawingLayer, LabelLayer } from "./drawing-layer.js";
import { showDrawings } from "./drawing-panel.js";
import { DrawingStore } from "./drawing-store.js";
import { connectSketch } from "./sketch.js";

/**
 * Show the drawings below the layer of the tracks, and their names above it.
 * @param {import("../mission-store.js").MissionStore} store
 * @param {import("../mission-view.js").MissionView} view
 * @param {L.Layer} scene the layer of the tracks, which is added here
 */
export function connectDrawings(store, view, scene) {
  const drawings = new DrawingStore(store);
  for (const layer of [new DrawingLayer(drawings, view), scene, new LabelLayer(drawings, view)]) view.add(layer);
  if (drawings.canEdit) connectSketch(drawings, view);
  showDrawings(drawings, (points) => {
    const [lats, lons] = [points.map(([lat]) => lat), points.map(([, lon]) => lon)];
    if (view.ground) view.show({ south: Math.min(...lats), west: Math.min(...lons), north: Math.max(...lats), east: Math.max(...lons) });
  });
}
