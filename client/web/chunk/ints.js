// Arrays of whole numbers as byte planes: all lowest bytes, then all second bytes, and so on.

import { ChunkError, allFinite, inRange } from "./error.js";

/** Inverse of the zigzag code 0, 1, 2, 3, … of 0, −1, 1, −2, …. */
export function unzigzag(code) {
  return (code >>> 1) ^ -(code & 1);
}

/** Reads `count` numbers, as a Uint32Array; the caller has checked `count`. */
export function takeU32s(reader, what, count) {
  const width = inRange(reader.section, "byte width", reader.u8(what), 0, 4);
  const planes = reader.take(what, count, width);
  const values = new Uint32Array(count);
  for (let plane = 0; plane < width; plane++) {
    const first = plane * count;
    const shift = 8 * plane;
    for (let index = 0; index < count; index++) values[index] |= planes[first + index] << shift;
  }
  return values;
}

/** Reads `count` signed numbers, as an Int32Array. */
export function takeI32s(reader, what, count) {
  const codes = takeU32s(reader, what, count);
  const values = new Int32Array(codes.buffer);
  for (let index = 0; index < count; index++) values[index] = unzigzag(codes[index]);
  return values;
}

/** Most bytes that an array of `count` numbers takes. */
export function bytesMax(count) {
  return 1 + 4 * count;
}

/** Reads `count` finite numbers that stand as one plane per byte of their bits, as a Float32Array. */
export function takeF32Planes(reader, what, count) {
  const numbers = new Float32Array(takeU32s(reader, what, count).buffer);
  allFinite(reader.section, what, numbers);
  return numbers;
}

/** Reads `count` differences from the number before, as the numbers, each of which must lie in `min..=max`. */
export function takeDeltas(reader, what, count, min, max) {
  const values = takeI32s(reader, what, count);
  let before = 0;
  for (let index = 0; index < count; index++) {
    const value = (before + values[index]) | 0;
    if (value < min || value > max) {
      const section = reader.section;
      const message = `${section}: ${what} is ${Math.abs(value)}, allowed is 0..=${Math.abs(max)}`;
      throw new ChunkError("out_of_range", message, { section, what });
    }
    values[index] = value;
    before = value;
  }
  return values;
}
