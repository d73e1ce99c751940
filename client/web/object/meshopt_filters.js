// Filters of compressed vertices: numbers as they compress well, and back. In f32, rounded to the nearest.

import { fround } from "../relight/numbers.js";

/** Undoes a filter of elements of `stride` bytes, in place; answers the bytes. */
export function filtered(bytes, filter, stride) {
  const isNarrow = stride === 4;
  const shorts = () => new Int16Array(bytes.buffer);
  if (filter === "OCTAHEDRAL") octahedral(isNarrow ? new Int8Array(bytes.buffer) : shorts(), isNarrow ? 127 : 32767);
  if (filter === "QUATERNION") quaternions(shorts());
  if (filter === "EXPONENTIAL") exponents(bytes.buffer);
  if (filter === "COLOR") {
    const own = isNarrow ? bytes : new Uint16Array(bytes.buffer);
    colours(own, isNarrow ? new Int8Array(bytes.buffer) : shorts(), isNarrow ? 255 : 65535);
  }
  return bytes;
}

/** Unit vectors of four numbers from places on an octahedron, whose third number is its size; the fourth stays. */
function octahedral(values, most) {
  for (let at = 0; at < values.length; at += 4) {
    let [x, y] = [values[at], values[at + 1]];
    const z = values[at + 2] - Math.abs(x) - Math.abs(y);
    // The lower half is folded over the corners of the upper one.
    const fold = Math.min(z, 0);
    x += x >= 0 ? fold : -fold;
    y += y >= 0 ? fold : -fold;
    const scale = fround(most / fround(Math.sqrt(fround(x * x + y * y + z * z))));
    [x, y, z].forEach((value, axis) => (values[at + axis] = rounded(fround(value * scale))));
  }
}

/** Unit quaternions without their largest component, which the last number names in its lowest bits, beside the scale. */
function quaternions(values) {
  for (let at = 0; at < values.length; at += 4) {
    const [x, y, z, last] = values.subarray(at, at + 4);
    const size = last | 3;
    const w = Math.sqrt(Math.max(2 * size * size - x * x - y * y - z * z, 0));
    const scale = fround(fround(32767 / Math.SQRT2) / size);
    [w, x, y, z].forEach((value, which) => (values[at + ((last + which) & 3)] = rounded(fround(fround(value) * scale))));
  }
}

/** Numbers of 24 bits, times two to the power of the highest eight; to f32. */
function exponents(buffer) {
  const [words, floats] = [new Int32Array(buffer), new Float32Array(buffer)];
  const power = new Float32Array(1);
  const bits = new Int32Array(power.buffer);
  words.forEach((word, at) => {
    // By its bits as the native decoder has it: 2⁻¹²⁷ is 0, and 2⁻¹²⁸ is -∞.
    bits[0] = ((word >> 24) + 127) << 23;
    floats[at] = ((word << 8) >> 8) * power[0];
  });
}

/** Colours of luma and two differences, as far as the highest bit of alpha, which stands for one more. */
function colours(values, signed, most) {
  for (let at = 0; at < values.length; at += 4) {
    const [luma, orange, green, alpha] = [values[at], signed[at + 1], signed[at + 2], values[at + 3]];
    const full = 2 ** (32 - Math.clz32(alpha)) - 1;
    const scale = fround(most / full);
    const own = ((alpha << 1) & full) | (alpha & 1);
    const parts = [luma + orange - green, luma + green, luma - orange - green, own];
    parts.forEach((part, channel) => (values[at + channel] = rounded(fround(part * scale))));
  }
}

/** The nearest whole number, of two the one farther from 0. */
function rounded(value) {
  return Math.sign(value) * Math.floor(Math.abs(value) + 0.5);
}
