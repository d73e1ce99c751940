// Vectors as arrays, matrices as sixteen numbers, column after column; projections with reversed depth. Twin of
// client/src/raster/camera.rs.

export function add(a, b) {
  return a.map((value, axis) => value + b[axis]);
}

export function less(a, b) {
  return a.map((value, axis) => value - b[axis]);
}

export function times(a, factor) {
  return a.map((value) => value * factor);
}

export function dot(a, b) {
  return a.reduce((sum, value, axis) => sum + value * b[axis], 0);
}

export function cross([ax, ay, az], [bx, by, bz]) {
  return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
}

/** The unit vector along one, or null where it has no length. */
export function normalised(vector) {
  const length = Math.hypot(...vector);
  return length > 0 && Number.isFinite(1 / length) ? times(vector, 1 / length) : null;
}

/** Product of two matrices. */
export function product(a, b) {
  const result = new Array(16).fill(0);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      for (let k = 0; k < 4; k++) {
        result[4 * column + row] += a[4 * k + row] * b[4 * column + k];
      }
    }
  }
  return result;
}

/** Clip coordinates of a point. */
export function transformed(matrix, [x, y, z]) {
  return [0, 1, 2, 3].map((row) => matrix[row] * x + matrix[4 + row] * y + matrix[8 + row] * z + matrix[12 + row]);
}

/** A matrix that moves points. */
export function translation([x, y, z]) {
  return [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1];
}

/** View of x right, y up, z forward: its matrix, and the unit vectors right and up. */
export function lookAlong(eye, forward, above) {
  const right = normalised(cross(forward, above));
  const up = cross(right, forward);
  const rows = [right, up, forward];
  const columns = [0, 1, 2].flatMap((axis) => [...rows.map((row) => row[axis]), 0]);
  return { matrix: [...columns, ...rows.map((row) => -dot(row, eye)), 1], right, up };
}

/** Perspective with depth near/z; half extents at distance 1. */
export function perspective(tanX, tanY, near) {
  return [1 / tanX, 0, 0, 0, 0, 1 / tanY, 0, 0, 0, 0, 0, 1, 0, 0, near, 0];
}

/** Parallel projection with depth 1 − z/far and half extents in metres. */
export function parallel(halfX, halfY, far) {
  return [1 / halfX, 0, 0, 0, 0, 1 / halfY, 0, 0, 0, 0, -1 / far, 0, 0, 0, 1, 1];
}
