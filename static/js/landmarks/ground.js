/** The satellite image, below the points. */

import { BufferAttribute, BufferGeometry, DoubleSide, Mesh, MeshBasicMaterial, SRGBColorSpace, TextureLoader } from "three";

/**
 * Make the ground plane.
 * @param {{corners: ?number[][], ground: number}} cloud
 * @param {?{url: string}} satellite
 * @param {function(): void} changed called when the image has loaded
 * @returns {?Mesh} null if the map has no image
 */
export function groundOf({ corners, ground }, satellite, changed) {
  if (!satellite || !corners) return null;
  const geometry = new BufferGeometry();
  const at = corners.flatMap(([x, y]) => [x, y, ground]);
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(at), 3));
  geometry.setAttribute("uv", new BufferAttribute(new Float32Array([0, 1, 1, 1, 1, 0, 0, 0]), 2));
  geometry.setIndex([0, 1, 2, 0, 2, 3]);
  const texture = new TextureLoader().load(satellite.url, changed);
  texture.colorSpace = SRGBColorSpace;
  texture.anisotropy = 4;
  // No depth: points below the ground stay visible, as its height is only roughly known.
  return new Mesh(geometry, new MeshBasicMaterial({ map: texture, side: DoubleSide, depthWrite: false }));
}
