// Affine maps of nodes in f64: twelve numbers, the columns of a 3×3 matrix and then a translation.

export const IDENTITY = [1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0];

/** `a ∘ b`. */
export function after(a, b) {
  const result = new Array(12);
  for (let column = 0; column < 4; column++) {
    const [x, y, z] = b.slice(3 * column, 3 * column + 3);
    for (let row = 0; row < 3; row++) {
      const moved = column === 3 ? a[9 + row] : 0;
      result[3 * column + row] = a[row] * x + a[3 + row] * y + a[6 + row] * z + moved;
    }
  }
  return result;
}

/** Translation × rotation × scale; a quaternion of length 0 turns nothing. */
export function ofParts(translation, [x, y, z, w], scale) {
  const length = Math.hypot(x, y, z, w);
  const [a, b, c, d] = length > 0 ? [x / length, y / length, z / length, w / length] : [0, 0, 0, 1];
  const rotation = [
    1 - 2 * (b * b + c * c), 2 * (a * b + c * d), 2 * (a * c - b * d),
    2 * (a * b - c * d), 1 - 2 * (a * a + c * c), 2 * (b * c + a * d),
    2 * (a * c + b * d), 2 * (b * c - a * d), 1 - 2 * (a * a + b * b),
  ];
  return [...rotation.map((value, at) => value * scale[Math.floor(at / 3)]), ...translation];
}

/** The map of a 4×4 matrix, column after column, without its last row. */
export function ofMatrix(m) {
  return [...m.slice(0, 3), ...m.slice(4, 7), ...m.slice(8, 11), ...m.slice(12, 15)];
}

/** Whether all numbers are finite as f32. */
export function isFinite32(map) {
  return map.every((value) => Number.isFinite(Math.fround(value)));
}

export function determinant([a, b, c, d, e, f, g, h, i]) {
  return a * (e * i - f * h) - d * (b * i - c * h) + g * (b * f - c * e);
}

/** Cofactors: the inverse transpose up to a positive factor, which exists also where a node is scaled flat. */
export function normalMatrix(map) {
  const [x, y, z] = [map.slice(0, 3), map.slice(3, 6), map.slice(6, 9)];
  const cross = ([ax, ay, az], [bx, by, bz]) => [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
  const cofactors = [...cross(y, z), ...cross(z, x), ...cross(x, y)];
  return determinant(map) < 0 ? cofactors.map((value) => -value) : cofactors;
}
