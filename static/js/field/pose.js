/** Where the phone is and which way it points, as far as the browser says. */

/** Fires `change`; `position` is {lat, lon, accuracy} or null, `heading` degrees clockwise from north or null. */
export class PhonePose extends EventTarget {
  constructor() {
    super();
    this.position = null;
    this.heading = null;
    this.problem = null;
    this.watching = false;
  }

  /** Ask for both; to be called by a click, as browsers want it. */
  async start() {
    if (this.watching) return;
    this.watching = true;
    navigator.geolocation.watchPosition(
      ({ coords }) => this._set({ position: { lat: coords.latitude, lon: coords.longitude, accuracy: coords.accuracy }, problem: null }),
      (problem) => this._set({ problem: problem.message || String(problem.code) }),
      { enableHighAccuracy: true, maximumAge: 2000 },
    );
    const compass = /** @type {*} */ (window.DeviceOrientationEvent);
    if (compass?.requestPermission && (await compass.requestPermission()) !== "granted") return;
    for (const name of ["deviceorientationabsolute", "deviceorientation"]) addEventListener(name, (event) => this._turn(event));
  }

  /** Safari states the heading itself; others an angle against north only where it is absolute. */
  _turn(event) {
    const { alpha, absolute, webkitCompassHeading: stated } = event;
    const screenTurn = screen.orientation?.angle ?? 0;
    if (typeof stated === "number") this._set({ heading: stated + screenTurn });
    else if (absolute && alpha !== null) this._set({ heading: 360 - alpha + screenTurn });
  }

  _set(fields) {
    Object.assign(this, fields);
    this.dispatchEvent(new Event("change"));
  }
}
