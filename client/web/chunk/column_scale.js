// Scales of columns: how much coarser the numbers of some columns of ΣVᵀ are stored than those of others.

import { inRange } from "./error.js";
import { isDifference, levelOf } from "./patch_key.js";

/** Scale of a step: `2^(code/4)`. */
const QUARTERS = [1, 1.189_207_1, Math.SQRT2, 1.681_792_8].map(Math.fround);
const CODE_MAX = 64;
/** Number of the first class of differences, above those of all levels. */
const DIFFERENCES = 16;

/** Most raw bytes of the scales of `count` columns. */
export function scalesBytesMax(count) {
  return Math.min(count, 32);
}

/** Reads the scale of each of `keys`, as a Float32Array: columns of one class have one. */
export function takeScales(reader, keys) {
  const classOf = (key) => levelOf(key) + (isDifference(key) ? DIFFERENCES : 0);
  const ofKeys = Array.from(keys, classOf);
  const classes = [...new Set(ofKeys)].sort((a, b) => a - b);
  const codes = reader.take("scales of columns", classes.length);
  codes.forEach((code) => inRange(reader.section, "scale of columns", code, 0, CODE_MAX));
  const scales = new Map(classes.map((of, index) => [of, scaleOf(codes[index])]));
  return Float32Array.from(ofKeys, (of) => scales.get(of));
}

function scaleOf(code) {
  return Math.fround(2 ** (code >> 2) * QUARTERS[code & 3]);
}
