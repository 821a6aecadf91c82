/** Vendored modules without types. */
declare module "three";
declare module "three/orbit-controls";
