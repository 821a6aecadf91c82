/** The masked parts of a panorama: single boxes, and boxes made from a mask image, which are shown as one mask. */

import { h, icon } from "../../shared/dom.js";
import { locale, t, tn } from "../../shared/i18n.js";
import { Boxes } from "../blur-dialog.js";

const SVG = "http://www.w3.org/2000/svg";
const SAME = 1e-4;
const LEAST_PARTS = 3;

/** Whether two boxes lie edge to edge, like those made from a mask image; ones drawn by hand practically never do. */
function isEdgeToEdge(one, other) {
  const [across, down] = [overlap(one.x, one.width, other.x, other.width), overlap(one.y, one.height, other.y, other.height)];
  return (Math.abs(across) < SAME && down > SAME) || (Math.abs(down) < SAME && across > SAME);
}

function overlap(from, length, otherFrom, otherLength) {
  return Math.min(from + length, otherFrom + otherLength) - Math.max(from, otherFrom);
}

/**
 * Find the boxes made from a mask image: groups that lie edge to edge.
 * @param {Object[]} boxes
 * @returns {Object[]}
 */
export function partsOfMask(boxes) {
  const groups = [];
  for (const box of boxes) {
    const joined = groups.filter((group) => group.some((other) => isEdgeToEdge(box, other)));
    for (const group of joined) groups.splice(groups.indexOf(group), 1);
    groups.push([...joined.flat(), box]);
  }
  return groups.filter(({ length }) => length >= LEAST_PARTS).flat();
}

/** Boxes like those for blurring, but a mask is shown and removed as a whole. */
export class MaskBoxes extends Boxes {
  /**
   * @param {*} frame
   * @param {Object[]} all
   */
  constructor(frame, all) {
    super(frame, []);
    /** Shows the size of the mask, with a button to remove it. */
    this.mask = h("span", { class: "row small" });
    this.replace(all);
  }

  /** The boxes that are not part of the mask. */
  get single() {
    const mask = new Set(partsOfMask(this.all));
    return this.all.filter((box) => !mask.has(box));
  }

  /** @override */
  _show() {
    super._show();
    this.frame.querySelector(".blur-mask")?.remove();
    const parts = partsOfMask(this.all);
    const share = parts.reduce((sum, { width, height }) => sum + width * height, 0);
    const words = t("Mask: {share} of the picture", { share: Math.max(share, 0.01).toLocaleString(locale, { style: "percent" }) });
    const remove = () => this.replace(this.single);
    const button = h("button", { class: "icon-button", type: "button", "aria-label": t("Remove this mask"), title: t("Remove this mask"), onclick: remove }, icon("close"));
    if (parts.length) this.frame.prepend(drawn(parts));
    this.mask?.replaceChildren(...(parts.length ? [words, button] : []));
    if (!parts.length) this.count.textContent = tn("{n} masked part", "{n} masked parts", this.all.length);
    else this.count.textContent = this.single.length ? tn("{n} box", "{n} boxes", this.single.length) : "";
  }

  /** @override */
  _shown() {
    return this.single;
  }
}

/** One shape without inner edges. */
function drawn(parts) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("class", "blur-mask");
  svg.setAttribute("viewBox", "0 0 1 1");
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", parts.map(({ x, y, width, height }) => `M${x} ${y}h${width}v${height}h${-width}z`).join(""));
  svg.append(path);
  return svg;
}
