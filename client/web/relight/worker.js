// A module Worker that does the work of `light_work.js` and of `sky_work.js`: calls come as `{id, name, args}`, answers go as `{id, value}` or `{id, error}`.
// Memory is handed over, not copied, but for what the work goes on with.

import { buffersOf, flatError, flatLight } from "./flat.js";
import { LightWork } from "./light_work.js";
import { SkyWork } from "./sky_work.js";

const [work, sky] = [new LightWork(), new SkyWork()];

/** By name of a call: what is answered, and what of it the work keeps. */
const CALLS = {
  decode: (...args) => handedOver(work.decode(...args)),
  begin: (parts) => ({ value: work.begin(parts), memory: [] }),
  add: (...args) => ({ value: work.add(...args), memory: [] }),
  end: (...args) => ({ value: work.end(...args), memory: [] }),
  light: (isWhole) => handedOver(flatLight(work.light(isWhole))),
  byNeed: (...args) => ({ value: work.byNeed(...args), memory: [] }),
  readSky: (...args) => handedOver(sky.read(...args)),
  takeSky: (...args) => handedOver(sky.take(...args)),
  skyMeans: (...args) => handedOver(sky.means(...args)),
};

function handedOver(value) {
  return { value, memory: buffersOf(value) };
}

self.addEventListener("message", ({ data: { id, name, args } }) => {
  try {
    const { value, memory } = CALLS[name](...args);
    self.postMessage({ id, value }, memory);
  } catch (error) {
    self.postMessage({ id, error: flatError(error) });
  }
});
self.postMessage({ isReady: true });
