/** Where the phone is and which way it points, as far as the browser says. */

/** Fires `change`; `position` is {lat, lon, accuracy} or null, `heading` degrees clockwise from north or null. */
export class PhonePose extends EventTarget {
  constructor() {
    super();
    this.position = null;
    this.heading = null;
    this.problem = null;
    this.watching = false;
    this.watch = null;
    this.compass = false;
  }

  /** Ask for both; to be called by a click, as browsers want it. */
  async start() {
    if (this.watching) return;
    this.watching = true;
    this.watch = navigator.geolocation.watchPosition(
      ({ coords }) => this._set({ position: { lat: coords.latitude, lon: coords.longitude, accuracy: coords.accuracy }, problem: null }),
      (problem) => this._failed(problem),
      { enableHighAccuracy: true, maximumAge: 2000 },
    );
    const compass = /** @type {*} */ (window.DeviceOrientationEvent);
    if (compass?.requestPermission && (await compass.requestPermission()) !== "granted") return;
    if (this.compass) return;
    this.compass = true;
    for (const name of ["deviceorientationabsolute", "deviceorientation"]) addEventListener(name, (event) => this._turn(event));
  }

  /** A position that is denied stays so until one asks again; other problems pass by themselves. */
  _failed(problem) {
    const denied = problem.code === problem.PERMISSION_DENIED;
    if (denied) navigator.geolocation.clearWatch(this.watch);
    this._set({ problem: problem.message || String(problem.code), watching: this.watching && !denied });
  }

  /** Safari gives the heading itself; others an angle against north only where it is absolute. */
  _turn(event) {
    const { alpha, absolute, webkitCompassHeading: compassDeg } = event;
    const screenTurn = screen.orientation?.angle ?? 0;
    if (typeof compassDeg === "number") this._set({ heading: compassDeg + screenTurn });
    else if (absolute && alpha !== null) this._set({ heading: 360 - alpha + screenTurn });
  }

  _set(fields) {
    Object.assign(this, fields);
    this.dispatchEvent(new Event("change"));
  }
}
