// Numbers as Rust has them.

export const fround = Math.fround;

/** To the nearest whole number, halves away from 0; `Math.round` takes them up. */
export function rounded(value) {
  return Math.sign(value) * Math.floor(Math.abs(value) + 0.5);
}

export function clamped(value, low, high) {
  return Math.min(Math.max(value, low), high);
}

const DECIMAL = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;
const NO_DECIMAL = /^([+-]?)(inf|infinity|nan)$/i;

/** The f32 of a text as Rust reads it; null where it is none. */
export function numberFrom(text) {
  if (DECIMAL.test(text)) return fround(Number(text));
  const [, sign, name] = NO_DECIMAL.exec(text) ?? [];
  if (name === undefined) return null;
  return name.toLowerCase() === "nan" ? NaN : sign === "-" ? -Infinity : Infinity;
}

/** The whole number of a text, from 0 to 2³² − 1; null where it is none. */
export function wholeFrom(text) {
  const isWhole = /^\+?0*\d{1,10}$/.test(text ?? "") && Number(text) < 2 ** 32;
  return isWhole ? Number(text) : null;
}

export function allFinite(values) {
  return values.every(Number.isFinite);
}
