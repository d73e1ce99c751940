// Order in which clusters are fetched; twin of client/src/stream/need.rs.

import { clamped } from "./numbers.js";

// Needs of clusters behind the eye count by this: their light reaches the picture by bounces alone.
const BEHIND = 0.125;

/**
 * Candidates, `{boundsM, receivers, bytes}`, by falling need: the square of the light that is known in a cluster, over the
 * cluster's bytes; less far from the eye and behind it. `lit` are the places whose light is known, `{positionM, irradiance}`,
 * four numbers each; without a viewpoint, `{positionM, forward}`, all places count alike. `sizeM` is the scene's.
 */
export function byNeed(candidates, { positionM, irradiance }, viewpoint, sizeM) {
  const along = Uint32Array.from({ length: positionM.length / 4 }, (_, place) => place);
  along.sort((a, b) => positionM[4 * a] - positionM[4 * b] || a - b);
  const needs = candidates.map(({ boundsM, receivers, bytes }) => {
    const square = squareIn(along, positionM, irradiance, boundsM);
    const weight = viewpoint === null ? 1 : seen(boundsM, viewpoint, sizeM);
    return (weight * square * receivers) / Math.max(bytes, 1);
  });
  return candidates.map((_, index) => index).sort((a, b) => needs[b] - needs[a] || a - b);
}

/** Mean square of the light in a box; where none of it is known, in one three times as wide. `along` ascends by x. */
function squareIn(along, positionM, irradiance, boundsM) {
  const size = Math.max(...[0, 1, 2].map((axis) => boundsM[3 + axis] - boundsM[axis]));
  for (const margin of [0.125 * size, size]) {
    const [low, high] = [boundsM.slice(0, 3).map((x) => x - margin), boundsM.slice(3).map((x) => x + margin)];
    const isInside = (first) => [1, 2].every((axis) => {
      return positionM[first + axis] >= low[axis] && positionM[first + axis] <= high[axis];
    });
    let [sum, count] = [0, 0];
    for (let at = firstFrom(along, positionM, low[0]); at < along.length; at++) {
      const first = 4 * along[at];
      if (positionM[first] > high[0]) break;
      if (isInside(first)) {
        sum += irradiance[first] ** 2 + irradiance[first + 1] ** 2 + irradiance[first + 2] ** 2;
        count++;
      }
    }
    if (count > 0) return sum / count;
  }
  return 0;
}

/** First of the places whose x is not below a number. */
function firstFrom(along, positionM, x) {
  let [first, end] = [0, along.length];
  while (first < end) {
    const middle = (first + end) >>> 1;
    if (positionM[4 * along[middle]] < x) first = middle + 1;
    else end = middle;
  }
  return first;
}

/** Share of a box in the view, about: 1 beside the eye, a half at an eighth of the scene's size, less behind. */
function seen(boundsM, { positionM, forward }, sizeM) {
  const axes = [0, 1, 2];
  const away = axes.map((axis) => positionM[axis] - clamped(positionM[axis], boundsM[axis], boundsM[3 + axis]));
  const far = (8 * Math.hypot(...away)) / Math.max(sizeM, 2 ** -126);
  const farthest = axes.map((axis) => boundsM[forward[axis] >= 0 ? 3 + axis : axis]);
  const ahead = axes.reduce((sum, axis) => sum + (farthest[axis] - positionM[axis]) * forward[axis], 0);
  return (ahead < 0 ? BEHIND : 1) / (1 + far * far);
}
