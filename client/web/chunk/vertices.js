// Arrays of vectors over all draws: each component on its own, as f32 or in whole steps of a fixed size.

import { inRange } from "./error.js";
import { bytesMax, takeDeltas, takeF32Planes } from "./ints.js";

const AS_STEPS = 1;
/** Most steps from zero, so that a step count is exact in f32. */
const STEPS_MAX = 2 ** 24;

/** Reads `count` vectors of `axes` components, flat; `perUnit` steps make 1, or 0 where numbers are never in steps. */
export function takeVectors(reader, axes, count, perUnit) {
  const what = reader.section;
  const mode = inRange(what, "mode", reader.u8("mode"), 0, perUnit > 0 ? AS_STEPS : 0);
  const vectors = new Float32Array(axes * count);
  for (let axis = 0; axis < axes; axis++) {
    const isSteps = mode === AS_STEPS;
    const numbers = isSteps
      ? takeDeltas(reader, what, count, -STEPS_MAX, STEPS_MAX)
      : takeF32Planes(reader, what, count);
    const unit = isSteps ? perUnit : 1;
    for (let index = 0; index < count; index++) vectors[axes * index + axis] = numbers[index] / unit;
  }
  return vectors;
}

/** Most raw bytes of `count` vectors of up to four components. */
export function vectorsBytesMax(count) {
  return 1 + 4 * bytesMax(count);
}
