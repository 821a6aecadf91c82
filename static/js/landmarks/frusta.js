/** The cameras: a dot and a frustum each, the chosen one with its photo; a panorama is only a larger dot. */

import {
  BufferAttribute, BufferGeometry, Color, DoubleSide, Group, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial,
  Points, PointsMaterial, SRGBColorSpace, TextureLoader, Vector3,
} from "three";

const EDGES = [[0, 1], [0, 2], [0, 3], [0, 4], [1, 2], [2, 3], [3, 4], [4, 1], [1, 5], [5, 2]];
const DOT_PX = 5;
const PANORAMA_PX = 9;

/**
 * Corners of a frustum: camera centre, image corners clockwise from the top left, and a mark above the image.
 * @param {Object} camera
 * @param {number} depth
 * @returns {Vector3[]}
 */
export function corners({ at, rotation, width, height, focal_px: focal }, depth) {
  const centre = new Vector3().fromArray(at);
  const [right, down, front] = rotation.map((axis) => new Vector3().fromArray(axis));
  const corner = (x, y) => centre.clone()
    .addScaledVector(front, depth)
    .addScaledVector(right, (x * depth * width) / (2 * focal))
    .addScaledVector(down, (y * depth * height) / (2 * focal));
  return [centre, corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1), corner(0, -1.35)];
}

/** All cameras. */
export class Frusta {
  /**
   * @param {Object[]} cameras
   * @param {{placed: string, tray: string, chosen: string}} colours
   * @param {number} depth of a frustum
   */
  constructor(cameras, colours, depth) {
    this.cameras = cameras;
    this.depth = depth;
    this.object = new Group();
    this.object.renderOrder = 2;
    this.chosen = null;
    this._chosenColour = colours.chosen;
    const lines = [];
    const shades = [];
    const photos = { at: [], colours: [] };
    const spheres = { at: [], colours: [] };
    for (const camera of cameras) {
      const colour = new Color(camera.placed ? colours.placed : colours.tray).toArray();
      const dots = camera.panorama ? spheres : photos;
      dots.at.push(...camera.at);
      dots.colours.push(...colour);
      if (camera.panorama) continue;
      const at = corners(camera, depth);
      for (const end of EDGES.flat()) {
        lines.push(...at[end].toArray());
        shades.push(...colour);
      }
    }
    const dotsOf = ({ at, colours: own }, size) => new Points(geometryOf(at, own), new PointsMaterial({ vertexColors: true, size, sizeAttenuation: false }));
    this.object.add(
      new LineSegments(geometryOf(lines, shades), new LineBasicMaterial({ vertexColors: true })),
      dotsOf(photos, DOT_PX),
      dotsOf(spheres, PANORAMA_PX),
    );
  }

  /**
   * Show a photo in its frustum; of a panorama only its position.
   * @param {?Object} camera
   * @param {function(): void} changed called when the photo has loaded
   */
  choose(camera, changed) {
    this.chosen?.removeFromParent();
    this.chosen = null;
    if (!camera) return;
    const dot = new PointsMaterial({ color: this._chosenColour, size: 3 * DOT_PX, sizeAttenuation: false, depthTest: false });
    this.chosen = new Group().add(new Points(geometryOf(camera.at), dot));
    this.object.add(this.chosen);
    if (camera.panorama) return;
    const at = corners(camera, 3 * this.depth);
    this.chosen.add(new LineSegments(geometryOf(EDGES.flat().flatMap((end) => at[end].toArray())), new LineBasicMaterial({ color: this._chosenColour })));
    if (!camera.preview) return;
    const sheet = new BufferGeometry();
    sheet.setAttribute("position", new BufferAttribute(new Float32Array(at.slice(1, 5).flatMap((one) => one.toArray())), 3));
    sheet.setAttribute("uv", new BufferAttribute(new Float32Array([0, 1, 1, 1, 1, 0, 0, 0]), 2));
    sheet.setIndex([0, 1, 2, 0, 2, 3]);
    const texture = new TextureLoader().load(camera.preview, changed);
    texture.colorSpace = SRGBColorSpace;
    const picture = new MeshBasicMaterial({ map: texture, side: DoubleSide, transparent: true, opacity: 0.8, depthWrite: false });
    this.chosen.add(new Mesh(sheet, picture));
  }
}

function geometryOf(positions, colours = null) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(positions), 3));
  if (colours) geometry.setAttribute("color", new BufferAttribute(new Float32Array(colours), 3));
  return geometry;
}
