// Numbers as Rust has them.

export const fround = Math.fround;

/** To the nearest whole number, halves away from 0; `Math.round` takes them up. */
export function rounded(value) {
  return Math.sign(value) * Math.floor(Math.abs(value) + 0.5);
}

export function clamped(value, low, high) {
  return Math.min(Math.max(value, low), high);
}

export function allFinite(values) {
  return values.every(Number.isFinite);
}
