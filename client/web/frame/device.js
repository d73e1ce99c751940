// Devices for frames: what of an adapter they need, and errors of a device while something is made on it.

import { errorsOf } from "./gpu.js";
import { BLENDABLE } from "./shade.js";

// Limits of a device that large bakes need: without a request they are the same small ones on all adapters.
const LIMITS = ["maxBufferSize", "maxStorageBufferBindingSize", "maxTextureDimension2D"];

/** Features of a device that frames have a use for, of those that an adapter has. */
export function featuresOf(adapter) {
  return [BLENDABLE].filter((feature) => adapter.features.has(feature));
}

/** Limits of a device that frames have a use for, as high as those of an adapter. */
export function limitsOf(adapter) {
  return Object.fromEntries(LIMITS.map((name) => [name, adapter.limits[name]]));
}

/** Runs `make`, and throws the errors of a device meanwhile before its own. */
export async function heard(device, make) {
  const ended = errorsOf(device);
  const failure = await make().then(
    () => null,
    (error) => ({ error }),
  );
  const error = await ended();
  if (error !== null) throw error;
  if (failure !== null) throw failure.error;
}
