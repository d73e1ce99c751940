// Settings of the level of detail; twin of proto/src/relight/lod/settings.rs. Numbers are those of f32.
//
//   { levels: [{ distance: { value, isMetres }, columns, rank, receivers, interval }, …], beside, behind, blend, margin }
//
// The levels, the finest first, begin at distances from the eye, in longest ways through the scene's bounds or in metres. From there on
// columns below a tree level are left out, and ranks above a number; receivers are computed whose texel coordinates both have so many
// trailing zero bits, once in `interval` bounces. `beside` and `behind` are factors on distances outside of the view, `blend` the share of
// a distance in which receivers go over to the next level, `margin` that by which an eye has to pass a distance.

import { MAX_RANK } from "./clusters.js";
import { clamped, fround } from "./numbers.js";

/** Levels of detail. */
export const LOD_LEVELS = 4;
// Most bounces from one update of a cluster to the next.
const INTERVAL_MAX = 16;
// Highest level of columns: that of the coarsest patches.
const COLUMNS_MAX = 15;
// Largest factor on distances.
const FACTOR_MAX = 1e6;
/** Stands for a distance that nothing has; shaders know no infinite numbers. */
export const NOWHERE_M = fround(1e30);
/** A distance that nothing has. */
export const NOWHERE = { value: Infinity, isMetres: true };

/** Everything, from a distance on. */
export function fullLevel(distance) {
  return { distance, columns: 0, rank: MAX_RANK, receivers: 0, interval: 1 };
}

/** Columns of the first level; levels behind it from distances in diagonals on, each with columns, receivers and interval. */
function presetOf(columns, distances, rest) {
  const at = (value) => fullLevel({ value: fround(value), isMetres: false });
  const level = ([ofColumns, receivers, interval], index) => {
    return { ...at(distances[index]), columns: ofColumns, receivers, interval };
  };
  const factors = { beside: 2, behind: 4, blend: fround(0.3), margin: fround(0.1) };
  return { levels: [{ ...at(0), columns }, ...rest.map(level)], ...factors };
}

/** Presets by name, from the most to the least detail. */
export const LOD_PRESETS = new Map([
  ["fine", presetOf(0, [0.1, 0.25, 0.5], [[3, 0, 1], [4, 0, 2], [4, 1, 2]])],
  ["balanced", presetOf(2, [0.1, 0.25, 0.5], [[4, 0, 2], [4, 1, 4], [5, 2, 4]])],
  ["coarse", presetOf(3, [0.05, 0.15, 0.3], [[4, 0, 2], [5, 1, 4], [5, 2, 8]])],
]);

/** Why settings make no levels of detail; null where they do. */
export function problemOfLod({ levels, beside, behind, blend, margin }) {
  for (const [index, level] of levels.entries()) {
    const problem = problemOfLevel(level);
    if (problem !== null) return `level ${index} of detail ${problem}`;
    if (index > 0 && levels[index - 1].receivers > level.receivers) {
      return `level ${index} of detail has more receivers than the one before: farther ones have as many or fewer`;
    }
  }
  const isFactor = (value, least) => value >= least && value <= FACTOR_MAX;
  if (!isFactor(beside, 1) || !isFactor(behind, beside)) {
    return `beside=${beside} behind=${behind}: give factors of 1 or more, the second no less than the first`;
  }
  const isShare = (value) => value >= 0 && value <= 1;
  return isShare(blend) && isShare(margin) ? null : `blend=${blend} margin=${margin}: give shares from 0 to 1`;
}

function problemOfLevel({ distance: { value }, columns, rank, receivers, interval }) {
  if (!(value >= 0)) return `begins at ${value}: give a distance of 0 or more`;
  if (columns > COLUMNS_MAX || rank < 1 || rank > MAX_RANK) {
    return `has columns from level ${columns} on and rank ${rank}: give at most ${COLUMNS_MAX}, and 1 to ${MAX_RANK}`;
  }
  if (receivers >= LOD_LEVELS) return `has receivers of level ${receivers}: give 0 to 3`;
  const isInterval = interval <= INTERVAL_MAX && Number.isInteger(Math.log2(interval));
  return isInterval ? null : `has interval ${interval}: give 1, 2, 4, 8 or 16`;
}

/** Where each level begins in a scene of that diagonal, in metres: none before the one before it. */
export function distancesM({ levels }, diagonalM) {
  let least = 0;
  return levels.map(({ distance }, index) => {
    if (index > 0) least = Math.max(least, metresOf(distance, diagonalM));
    return least;
  });
}

function metresOf({ value, isMetres }, diagonalM) {
  return Math.min(isMetres ? value : fround(value * diagonalM), NOWHERE_M);
}

/** Factor on the distance of a place at a cosine from the view, whose corners are at `viewCos`. */
export function zoneOf({ beside, behind }, cos, viewCos) {
  if (cos >= viewCos) return 1;
  if (cos >= 0) return fround(beside + fround(fround(1 - beside) * fround(cos / viewCos)));
  return fround(beside + fround(fround(behind - beside) * -cos));
}

/** Distance of the closest place of bounds (low, then high) in metres, longer outside of the view: no place within them is closer. */
export function closestM(boundsM, lod, { positionM, forward, viewCos }) {
  const [low, high] = [boundsM.subarray(0, 3), boundsM.subarray(3, 6)];
  if (low.some((bound, axis) => bound > high[axis])) return Infinity;
  const closest = positionM.map((at, axis) => clamped(at, low[axis], high[axis]));
  const length = lengthOf(between(positionM, closest));
  const middle = Array.from(low, (bound, axis) => fround(0.5 * fround(bound + high[axis])));
  const radius = fround(0.5 * lengthOf(between(low, high)));
  const way = between(positionM, middle);
  const toMiddle = lengthOf(way);
  let cos = 1;
  if (toMiddle > radius) {
    // The ball around the bounds is seen within this angle.
    const half = fround(Math.asin(fround(radius / toMiddle)));
    const angle = fround(Math.acos(clamped(fround(along(way, forward) / toMiddle), -1, 1)));
    cos = fround(Math.cos(Math.max(fround(angle - half), 0)));
  }
  return fround(length * zoneOf(lod, cos, viewCos));
}

/** From one place to another, in f32. */
function between(from, to) {
  return Array.from(to, (at, axis) => fround(at - from[axis]));
}

/** Product of two vectors, in f32. */
function along(a, b) {
  return fround(fround(fround(a[0] * b[0]) + fround(a[1] * b[1])) + fround(a[2] * b[2]));
}

function lengthOf(way) {
  return fround(Math.sqrt(along(way, way)));
}
