// Cameras, and the camera and sky as the shaders read them; twin of client/src/passes/shade/view.rs.

import { fround } from "../relight/numbers.js";
import { add, cross, less, lookAlong, normalised, parallel, perspective, product, times } from "./maths.js";

/** Numbers of a view: matrix, zenith, horizon, ray, its changes per ndc x and y. */
export const VIEW_NUMBERS = 36;

/** Clip space of a camera for a picture of `size` pixels; bounds of the scene set near and far. */
function clipFromWorld(camera, size, boundsM) {
  const wrong = (problem) => {
    throw new Error(`camera '${camera.name ?? ""}': ${problem}`);
  };
  const { eyeM, targetM, up, fovYRad, orthographicHalfHeightM: half } = camera;
  const forward = normalised(less(targetM, eyeM)) ?? wrong("eye and target are the same point");
  if (!(Math.hypot(...cross(forward, up)) > 1e-5)) {
    wrong("up points along the view");
  }
  const { matrix } = lookAlong(eyeM, forward, up);
  const [low, high] = boundsM;
  const diagonal = Math.max(Math.hypot(...less(high, low)), 2 ** -126);
  const aspect = size[0] / size[1];
  if (half !== null && half !== undefined) {
    if (!(half > 0 && Number.isFinite(half))) {
      wrong("its orthographic half height is not a positive number");
    }
    const far = Math.hypot(...less(eyeM, times(add(low, high), 0.5))) + diagonal;
    return product(parallel(half * aspect, half, far), matrix);
  }
  const tan = Math.tan(0.5 * fovYRad);
  if (!(tan > 1e-4 && tan < 1e3)) {
    wrong("its field of view is not between 0 and 180 degrees");
  }
  return product(perspective(tan * aspect, tan, 1e-4 * diagonal), matrix);
}

/** Details of surfaces that transport does not know, all of which are shown. */
export const ALL_DETAILS = Object.freeze({ normalMaps: true, specular: true });

/** A view whose samples lie `jitter` pixels (right, down) from the pixels' centres: its matrix, and its numbers for the shader. */
export function shadeView(camera, size, boundsM, sky, jitter, details = ALL_DETAILS) {
  const steady = clipFromWorld(camera, size, boundsM);
  const shift = [(-2 * jitter[0]) / size[0], (2 * jitter[1]) / size[1]];
  // ndc shifts by a constant: clip.xy += shift · clip.w.
  const matrix = product([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, ...shift, 0, 1], steady);
  // Per ndc, the second row grows by the reciprocal of half the picture's height in metres.
  const pixelAtUnitW = 2 / (Math.hypot(steady[1], steady[5], steady[9]) * size[1]);
  const [ray, perX, perY] = rays(camera, size, shift);
  const leftOut = [details.specular, details.normalMaps].map((isShown) => (isShown ? 0 : 1));
  const numbers = [matrix, sky.zenith, leftOut[0], sky.horizon, 0, ray, leftOut[1], perX, 0, perY, pixelAtUnitW].flat();
  return { matrix, numbers: Float32Array.from(numbers) };
}

/** Direction through the middle, and its change per ndc x and y; parallel cameras look one way everywhere. */
function rays(camera, size, shift) {
  const forward = normalised(less(camera.targetM, camera.eyeM));
  if (isParallel(camera)) {
    return [forward, [0, 0, 0], [0, 0, 0]];
  }
  const right = normalised(cross(forward, camera.up));
  const tan = Math.tan(0.5 * camera.fovYRad);
  const perX = times(right, (tan * size[0]) / size[1]);
  const perY = times(cross(right, forward), tan);
  return [less(less(forward, times(perX, shift[0])), times(perY, shift[1])), perX, perY];
}

/** Where suns' cascades are; null for a parallel camera, which sees all alike. */
export function eyeOf(camera) {
  const forward = normalised(less(camera.targetM, camera.eyeM));
  return forward === null || isParallel(camera) ? null : { positionM: camera.eyeM, forward };
}

/** The eye of levels of detail (`LodPlan`) for a picture of `size` pixels, in numbers of f32; null for a parallel camera. */
export function lodEyeOf(camera, [width, height], [low, high]) {
  const eye = eyeOf(camera);
  if (eye === null) return null;
  const toCorner = Math.tan(0.5 * camera.fovYRad) * Math.hypot(width / height, 1);
  return {
    positionM: Array.from(eye.positionM, fround),
    forward: Array.from(eye.forward, fround),
    viewCos: fround(1 / Math.hypot(toCorner, 1)),
    diagonalM: fround(Math.hypot(...less(high, low))),
  };
}

function isParallel({ orthographicHalfHeightM: half }) {
  return half !== null && half !== undefined;
}
