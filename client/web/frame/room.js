// Room of a frame's shadow maps.

import { POINT } from "./lights.js";
import { isRoom, roomFor } from "./plan.js";

// Texels along a side of a shadow map, and room for lights and maps, unless asked otherwise or the bake's own lights need more.
const SHADOW_SIDE = 1024;
const LIGHTS = 8;
const FACES = 24;
// A light that people may add to the bake's own.
const ADDED = { shape: POINT, cone: [-1, -2] };

/** Room for some lights and one more, if there may be so many, and no less than for a few. */
export function roomWith(casters) {
  const [alone, more] = [casters, [...casters, ADDED]].map((lights) => roomFor(lights, SHADOW_SIDE));
  const own = isRoom(more) ? more : alone;
  const wanted = { ...own, lights: Math.max(own.lights, LIGHTS), faces: Math.max(own.faces, FACES) };
  // Fewer texels, where many lights need many maps.
  return wanted.faces * wanted.side ** 2 > 2 ** 26 ? own : wanted;
}
