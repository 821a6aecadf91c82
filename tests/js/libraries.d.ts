/** Vendored modules without types. */
declare module "three";
declare module "three/orbit-controls";

/** Schemas of the API, as in `Api["PhotoOut"]`. */
type Api = import("./api").components["schemas"];
