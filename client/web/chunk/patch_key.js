// Keys of columns as BigInts of 64 bits: level (4 bits, 15 is the sky), direction (5), cell y, z, x (15 each, plus 2¹⁴), number (10).
// That of a difference is the patch's with the highest bit of the direction set.

const SKY_LEVEL = 15;
const DIFFERENCE = 1n << 59n;
const SKY = 15n << 60n;

/** Level, 0…14 of a patch. */
export function levelOf(key) {
  return Number(key >> 60n);
}

/** Direction of a patch, 0…5: +x −x +y −y +z −z. */
export function directionOf(key) {
  return Number((key >> 55n) & 0x1fn);
}

/** Cell x, y, z of a patch on the lattice of its level. */
export function cellOf(key) {
  return [10n, 40n, 25n].map((shift) => Number((key >> shift) & 0x7fffn) - 0x4000);
}

/** Part of the sky that a key names, or null. */
export function skyPartOf(key) {
  return key >> 32n === SKY >> 32n ? Number(key & 0xffff_ffffn) : null;
}

/** Key of part `part` of the sky. */
export function skyKey(part) {
  return SKY | BigInt(part);
}

/** Whether it is the key of a difference. */
export function isDifference(key) {
  return levelOf(key) !== SKY_LEVEL && (key & DIFFERENCE) !== 0n;
}

/** Key of the column that reads a patch's radiance less that of the patch which it is part of. */
export function differenceOf(key) {
  return key | DIFFERENCE;
}

/** Key of the patch itself that a column reads. */
export function patchOf(key) {
  return isDifference(key) ? key & ~DIFFERENCE : key;
}

/** Key of patch `ordinal` at `level` in `place`: direction · 2⁴⁵ and the cell's 45 bits. */
export function keyAt(level, place, ordinal) {
  return (BigInt(level) << 60n) | (BigInt(place) << 10n) | BigInt(ordinal);
}
