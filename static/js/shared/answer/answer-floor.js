/** Shows the floor of the selected hypothesis. */

/**
 * @param {import("./query-session.js").QuerySession} session
 * @param {import("../map/map-store.js").MapStore} store
 */
export function followFloor(session, store) {
  session.on("chosen", () => session.hypothesis?.floor !== undefined && store.showFloor(session.hypothesis.floor));
}
