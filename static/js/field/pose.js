/** Position and heading of the phone, as far as the browser knows them. */

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

  /** Start both sensors; browsers require that a click calls this. */
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

  /** After a denial, stop until `start` is called again; other problems may be temporary. */
  _failed(problem) {
    const denied = problem.code === problem.PERMISSION_DENIED;
    if (denied) navigator.geolocation.clearWatch(this.watch);
    this._set({ problem: problem.message || String(problem.code), watching: this.watching && !denied });
  }

  /** Safari provides the heading; in other browsers, the angle refers to north only if it is absolute. */
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
