/** A photo shown first as a thumbnail, which the large picture replaces when it has loaded. */

/** Shows one photo at a time in a frame, which has the class `is-broken` while it cannot be shown. */
export class ProgressiveImage {
  /**
   * @param {HTMLElement} frame
   * @param {HTMLImageElement} image
   */
  constructor(frame, image) {
    this.frame = frame;
    this.image = image;
    this._shown = null;
    this._large = new Image();
    image.addEventListener("error", () => frame.classList.add("is-broken"));
    image.addEventListener("load", () => frame.classList.remove("is-broken"));
  }

  /**
   * @param {?{name: string, thumb?: string, preview?: string}} photo null shows none; without `preview`, details are not loaded yet
   * @returns {boolean} whether it is another picture than before
   */
  show(photo) {
    const address = photo?.preview ?? null;
    if (this._shown === address) return false;
    this._shown = address;
    for (const image of [this.image, this._large]) image.removeAttribute("src"); // what still loads would hold up the next one
    if (!address) return false;
    this.image.alt = photo.name;
    this.image.src = photo.thumb;
    const large = (this._large = new Image());
    large.src = address;
    // Browsers may decline to decode ahead, when they have little memory: a picture that has loaded is shown all the same.
    large.decode().catch(() => {}).then(() => {
      if (this._shown !== address) return;
      if (large.naturalWidth) this.image.src = large.src;
      else this.frame.classList.toggle("is-broken", !this.image.naturalWidth);
    });
    return true;
  }
}
