// From a primitive's own space to that of the object: places, unit normals and winding; twin of worker/src/scene/placement.rs.

import { ObjectError } from "./error.js";
import { determinant, normalMatrix } from "./affine.js";

// A triangle whose doubled area is below this share of its longest edge squared has no area.
const MIN_RELATIVE_AREA = 1e-8;
// Least and most length of a vector that has a direction, as that of f64.
const LENGTH_MAX = Number.MAX_VALUE;

/**
 * Places and unit normals of the vertices of a shape, `{positions, normals}`, under a map; without normals, of three vertices for each
 * triangle. Errs for places beyond f32.
 */
export function placed({ positions, normals }, triangles, map, place) {
  const moved = movedBy(map, positions, place);
  if (normals === null) return flat(moved, triangles);
  return { positions: moved, normals: turned(normals, moved, triangles, normalMatrix(map)) };
}

/** Whether a map turns front faces into back faces. */
export function isMirrored(map) {
  return determinant(map) < 0;
}

function movedBy(m, positions, place) {
  const moved = new Float32Array(positions.length);
  for (let at = 0; at < positions.length; at += 3) {
    const [x, y, z] = [positions[at], positions[at + 1], positions[at + 2]];
    for (let row = 0; row < 3; row++) moved[at + row] = m[row] * x + m[3 + row] * y + m[6 + row] * z + m[9 + row];
    if (!(Number.isFinite(moved[at]) && Number.isFinite(moved[at + 1]) && Number.isFinite(moved[at + 2]))) {
      throw new ObjectError(`${place()}: the position of vertex ${at / 3} is not finite; repair the mesh and export again`);
    }
  }
  return moved;
}

/** Three vertices of each triangle, with its face's normal. */
function flat(positions, triangles) {
  const own = new Float32Array(3 * triangles.length);
  const normals = new Float32Array(3 * triangles.length);
  for (let first = 0; first < triangles.length; first += 3) {
    const face = faceNormal(positions, triangles, first);
    for (let corner = first; corner < first + 3; corner++) {
      own.set(positions.subarray(3 * triangles[corner], 3 * triangles[corner] + 3), 3 * corner);
      normals.set(face?.normal ?? [0, 1, 0], 3 * corner);
    }
  }
  return { positions: own, normals };
}

/** Unit normal of a triangle and twice its area, or null if it has no area. */
function faceNormal(positions, triangles, first) {
  const [a, b, c] = [0, 1, 2].map((corner) => 3 * triangles[first + corner]);
  const edge = (from, to) => [0, 1, 2].map((axis) => positions[to + axis] - positions[from + axis]);
  const [ab, ac, bc] = [edge(a, b), edge(a, c), edge(b, c)];
  const cross = [ab[1] * ac[2] - ab[2] * ac[1], ab[2] * ac[0] - ab[0] * ac[2], ab[0] * ac[1] - ab[1] * ac[0]];
  const squared = ([x, y, z]) => x * x + y * y + z * z;
  const doubledArea = Math.sqrt(squared(cross));
  if (!(doubledArea > MIN_RELATIVE_AREA * Math.max(squared(ab), squared(ac), squared(bc)))) return null;
  return { normal: cross.map((value) => value / doubledArea), doubledArea };
}

/** Stated normals under a normal matrix, made unit; those that are none are taken from the triangles. */
function turned(normals, positions, triangles, m) {
  const unit = new Float32Array(normals.length);
  let fromFaces = null;
  for (let at = 0; at < normals.length; at += 3) {
    const [x, y, z] = [normals[at], normals[at + 1], normals[at + 2]];
    const own = unitOf([0, 1, 2].map((row) => m[row] * x + m[3 + row] * y + m[6 + row] * z));
    if (own === null) fromFaces ??= normalsFromFaces(positions, triangles);
    unit.set(own ?? fromFaces[at / 3] ?? [0, 1, 0], at);
  }
  return unit;
}

function unitOf(vector) {
  const length = Math.sqrt(vector.reduce((sum, value) => sum + value * value, 0));
  const reciprocal = 1 / length;
  return reciprocal > 0 && reciprocal <= LENGTH_MAX ? vector.map((value) => value * reciprocal) : null;
}

/** Per vertex, the mean of its triangles' normals weighted by area, or the first one where they cancel. */
function normalsFromFaces(positions, triangles) {
  const [sums, firsts] = [[], []];
  for (let first = 0; first < triangles.length; first += 3) {
    const face = faceNormal(positions, triangles, first);
    if (face === null) continue;
    for (const vertex of triangles.subarray(first, first + 3)) {
      sums[vertex] = (sums[vertex] ?? [0, 0, 0]).map((sum, axis) => sum + face.normal[axis] * face.doubledArea);
      firsts[vertex] ??= face.normal;
    }
  }
  return sums.map((sum, vertex) => unitOf(sum) ?? firsts[vertex]);
}
