// What is seen at a place of the picture: rays through it, and the nearest triangle that they meet.

import { add, cross, less, normalised, times } from "./frame/maths.js";
import { VERTEX_NUMBERS } from "./relight/draws.js";

// Share of a ray's length that a point is put before what it meets.
const LEVEL = 1e-3;

/** The ray of a perspective through a place of its picture, in shares of its width from the left and of its height from the top. */
export function rayThrough({ eyeM, targetM, up, fovYRad }, [x, y], aspect) {
  const forward = normalised(less(targetM, eyeM));
  const right = normalised(cross(forward, up));
  const above = cross(right, forward);
  const tan = Math.tan(0.5 * fovYRad);
  const aside = add(times(right, (2 * x - 1) * tan * aspect), times(above, (1 - 2 * y) * tan));
  return { originM: [...eyeM], direction: normalised(add(forward, aside)) };
}

/** A point along a ray. */
export function pointAt({ originM, direction }, distanceM) {
  return add(originM, times(direction, distanceM));
}

/** Distance in metres to the nearest triangle of meshes, `{vertices, triangles}`, that a ray meets; Infinity where it meets none. */
export function distanceTo(ray, draws) {
  return draws.reduce((nearest, draw) => Math.min(nearest, distanceToDraw(ray, draw)), Infinity);
}

/**
 * Where a thing of a radius in metres may stand that is put where a ray meets meshes: there, if that is level, else on what lies below,
 * beside what the ray meets; null where it meets nothing.
 */
export function footAt(ray, draws, radiusM) {
  const distance = distanceTo(ray, draws);
  if (distance === Infinity) return null;
  const met = pointAt(ray, distance);
  // A little before, so that the way down does not begin within the surface.
  const below = (beforeM) => {
    const way = { originM: pointAt(ray, distance - Math.min(beforeM, distance / 2)), direction: [0, -1, 0] };
    return { beforeM, downM: distanceTo(way, draws), way };
  };
  const here = below(LEVEL * distance);
  if (here.downM <= 2 * here.beforeM) return met;
  const { downM, way } = below(radiusM + LEVEL * distance);
  return downM < Infinity ? pointAt(way, downM) : met;
}

function distanceToDraw(ray, { vertices, triangles }) {
  let nearest = Infinity;
  for (let first = 0; first < triangles.length; first += 3) {
    const distance = distanceToTriangle(ray, vertices, VERTEX_NUMBERS * triangles[first],
      VERTEX_NUMBERS * triangles[first + 1], VERTEX_NUMBERS * triangles[first + 2]);
    if (distance < nearest) nearest = distance;
  }
  return nearest;
}

/** Möller and Trumbore's test, of both sides; plain numbers, as scenes have millions of triangles. */
function distanceToTriangle({ originM: [ox, oy, oz], direction: [dx, dy, dz] }, v, a, b, c) {
  const [abx, aby, abz] = [v[b] - v[a], v[b + 1] - v[a + 1], v[b + 2] - v[a + 2]];
  const [acx, acy, acz] = [v[c] - v[a], v[c + 1] - v[a + 1], v[c + 2] - v[a + 2]];
  const [px, py, pz] = [dy * acz - dz * acy, dz * acx - dx * acz, dx * acy - dy * acx];
  const determinant = abx * px + aby * py + abz * pz;
  if (determinant === 0) return Infinity;
  const [tx, ty, tz] = [ox - v[a], oy - v[a + 1], oz - v[a + 2]];
  const s = (tx * px + ty * py + tz * pz) / determinant;
  const [qx, qy, qz] = [ty * abz - tz * aby, tz * abx - tx * abz, tx * aby - ty * abx];
  const t = (dx * qx + dy * qy + dz * qz) / determinant;
  const distance = (acx * qx + acy * qy + acz * qz) / determinant;
  return s >= 0 && t >= 0 && s + t <= 1 && distance > 0 ? distance : Infinity;
}

/** Where a ray meets the plane y = height; null where it does not, or beyond so many metres. */
export function onPlane(ray, heightM, mostM) {
  const distance = (heightM - ray.originM[1]) / ray.direction[1];
  return distance > 0 && distance <= mostM ? pointAt(ray, distance) : null;
}

