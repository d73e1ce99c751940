// The picture of a panorama, and a small one of the same light; twin of proto/src/relight/panorama_image.rs.

import { fround } from "./numbers.js";

/** Most pixels of a panorama: 8192 × 4096. */
export const PIXELS_MAX = 2 ** 25;
/** Brightest pixel in W·m⁻²·sr⁻¹: sums over the sky stay far below the largest 32-bit number. */
export const RADIANCE_MAX = fround(1e30);
/** Columns and rows from which on a pixel counts as one direction. */
export const FINE = [1024, 512];
// Widest panorama, in heights; the narrowest is a square.
const WIDEST = 4;

/** Checks `{width, height, pixels}`, three numbers a pixel, the uppermost row first; answers the largest number. */
export function checkImage({ width, height, pixels }) {
  const size = `it has ${width} × ${height} pixels`;
  const isSide = (side) => Number.isInteger(side) && side > 0;
  if (!isSide(width) || !isSide(height)) throw new Error(`${size}: give a picture that has some`);
  if (width * height > PIXELS_MAX) throw new Error(`${size}, more than the ${PIXELS_MAX} of a panorama: make it smaller`);
  if (pixels.length !== 3 * width * height) throw new Error(`${size}, but ${pixels.length / 3} colours: give as many`);
  if (width < height || width > WIDEST * height) {
    const shape = `one of the whole sky is twice as wide as high, and 1 to ${WIDEST} times is read`;
    throw new Error(`${size}; ${shape}: convert it to equirectangular projection`);
  }
  const bad = pixels.findIndex((value) => !(value >= 0 && value <= RADIANCE_MAX));
  if (bad >= 0) {
    const pixel = Math.floor(bad / 3);
    const place = `${pixel % width},${Math.floor(pixel / width)}`;
    throw new Error(`its pixel ${place} is negative, not finite or above ${RADIANCE_MAX.toExponential(0).replace("+", "")}`);
  }
  return pixels.reduce((most, value) => Math.max(most, value), 0);
}

/** The same light in `FINE` pixels at most, each the mean by solid angle. */
export function reduced(image) {
  const [width, height] = [Math.min(image.width, FINE[0]), Math.min(image.height, FINE[1])];
  if (width === image.width && height === image.height) return image;
  const columns = pieces(image.width, width);
  const up = (edge) => Math.cos(edge * Math.PI);
  const sums = new Float64Array(3 * width * height);
  for (const down of pieces(image.height, height)) {
    const [upper, lower] = [up(down.into / height), up((down.into + 1) / height)];
    const share = ((up(down.from) - up(down.to)) / (upper - lower)) * width;
    for (const across of columns) {
      const weight = share * (across.to - across.from);
      const [into, from] = [3 * (down.into * width + across.into), 3 * (down.cell * image.width + across.cell)];
      for (let channel = 0; channel < 3; channel++) sums[into + channel] += weight * image.pixels[from + channel];
    }
  }
  return { width, height, pixels: Float32Array.from(sums) };
}

/** The parts of so many cells alike in fewer ones alike, in order, the whole being from 0 to 1. */
function pieces(cells, into) {
  // Both have whole edges in steps of 1/(cells · into).
  const end = cells * into;
  const found = [];
  for (let at = 0; at < end; ) {
    const [cell, larger] = [Math.floor(at / into), Math.floor(at / cells)];
    const next = Math.min((cell + 1) * into, (larger + 1) * cells);
    found.push({ cell, into: larger, from: at / end, to: next / end });
    at = next;
  }
  return found;
}

// Largest 16-bit number.
const HALF_MAX = 65504;

/** Pixels as textures have them, four 16-bit numbers each, and the radiance of a texel of 1. */
export function texelsOf({ pixels }, brightest) {
  const scale = Math.max(fround(brightest / HALF_MAX), 1);
  const texels = new Uint16Array((pixels.length / 3) * 4);
  const last = halfOf(scale);
  for (let from = 0, to = 0; from < pixels.length; from += 3, to += 4) {
    for (let channel = 0; channel < 3; channel++) {
      // Rounding must not take the brightest one to infinity.
      texels[to + channel] = halfOf(Math.min(fround(pixels[from + channel] / scale), HALF_MAX));
    }
    texels[to + 3] = last;
  }
  return { texels, scale };
}

const asFloat = new Float32Array(1);
const asWord = new Uint32Array(asFloat.buffer);

/** The 16-bit number nearest to one that is not negative, of two the even one. */
function halfOf(value) {
  if (value < 2 ** -14) {
    const whole = Math.floor(value * 2 ** 24);
    const rest = value * 2 ** 24 - whole;
    return whole + (rest > 0.5 || (rest === 0.5 && whole % 2 === 1) ? 1 : 0);
  }
  asFloat[0] = Math.min(value, HALF_MAX);
  const word = asWord[0] - 0x38000000;
  return (word + 0xfff + ((word >>> 13) & 1)) >>> 13;
}
