/** The points, in blocks that are loaded one after the other. Each block is a sample of the whole cloud. */

import { BufferAttribute, BufferGeometry, Group, Points, ShaderMaterial, Vector3 } from "three";
import { rampColours } from "./height-ramp.js";

const VERTEX = `
attribute vec4 shade;
uniform float pointSize;
uniform float reach;
uniform float leastSeen;
uniform bool byHeight;
uniform float low;
uniform float high;
uniform vec3 ramp[5];
varying vec3 tint;

vec3 rampAt(float share) {
  float at = clamp(share, 0.0, 1.0) * 4.0;
  int stop = int(min(floor(at), 3.0));
  vec3 from = ramp[0];
  vec3 to = ramp[1];
  for (int i = 1; i < 4; i++) if (i == stop) { from = ramp[i]; to = ramp[i + 1]; }
  return mix(from, to, at - float(stop));
}

void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  vec4 seen = viewMatrix * world;
  gl_Position = projectionMatrix * seen;
  gl_PointSize = reach > 0.0 ? pointSize * clamp(reach / -seen.z, 0.7, 3.0) : pointSize;
  tint = byHeight ? rampAt((world.z - low) / (high - low)) : shade.rgb;
  if (shade.a * 255.0 < leastSeen - 0.5) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}`;

const FRAGMENT = `
varying vec3 tint;
void main() {
  vec2 off = gl_PointCoord - 0.5;
  if (dot(off, off) > 0.25) discard;
  gl_FragColor = vec4(tint, 1.0);
}`;

/** All points of a cloud. */
export class PointLayer {
  /** @param {{offset: number[], scale: number[]}} cloud */
  constructor({ offset, scale }) {
    this.object = new Group();
    this.object.position.fromArray(offset);
    this.object.scale.fromArray(scale);
    this.object.renderOrder = 1;
    this.total = 0;
    this.material = new ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: {
        pointSize: { value: 2 },
        reach: { value: 0 },
        leastSeen: { value: 2 },
        byHeight: { value: false },
        low: { value: 0 },
        high: { value: 1 },
        ramp: { value: rampColours().map((stop) => new Vector3().fromArray(stop)) },
      },
    });
  }

  /** @param {string} name of a uniform @param {*} value */
  set(name, value) {
    this.material.uniforms[name].value = value;
  }

  /** @param {{count: number, steps: Uint16Array, colours: Uint8Array}} block */
  add({ count, steps, colours }) {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(steps, 4));
    geometry.setAttribute("shade", new BufferAttribute(colours, 4, true));
    const points = new Points(geometry, this.material);
    points.frustumCulled = false;
    points.userData.count = count;
    this.object.add(points);
    this.total += count;
  }

  /** Draw a part of the points, spread over the whole cloud. @param {number} first @param {number} end */
  show(first, end) {
    const at = (number, count) => Math.round((number / Math.max(1, this.total)) * count);
    for (const { geometry, userData: { count } } of this.object.children) {
      geometry.setDrawRange(at(first, count), at(end, count) - at(first, count));
    }
  }
}
