// Codes of single quantities: positions, normals, albedo, irradiance. Sums are in f64 and rounded once to f32, as in Rust.

/** Albedo above this is coded as this. */
const ALBEDO_MAX = Math.fround(0.999);
const STEPS_PER_OCTAVE = 512;
const CODE_OF_ONE = 32_768;

/** `x = lo + (hi − lo)·q/65535` as f32; exact at both ends. */
export function positionOf(code, lo, hi) {
  return Math.fround(lo + (hi - lo) * (code / 65_535));
}

/** Puts the unit vector of an octahedral code to `out[at..at + 3]`. */
export function putNormal(out, at, codeU, codeV) {
  const u = Math.max(codeU, -32_767) / 32_767;
  const v = Math.max(codeV, -32_767) / 32_767;
  const z = 1 - Math.abs(u) - Math.abs(v);
  const isFolded = z < 0;
  const x = isFolded ? (1 - Math.abs(v)) * signOf(u) : u;
  const y = isFolded ? (1 - Math.abs(u)) * signOf(v) : v;
  const length = Math.sqrt(x * x + y * y + z * z);
  out[at] = x / length;
  out[at + 1] = y / length;
  out[at + 2] = z / length;
}

function signOf(number) {
  return number < 0 ? -1 : 1;
}

/** `ρ = ALBEDO_MAX·(q/255)²`. */
export function albedoOf(code) {
  const root = code / 255;
  return Math.fround(ALBEDO_MAX * root * root);
}

/** `E = 2^((q − 32768)/512)`, and 0 for q = 0. */
export function irradianceOf(code) {
  return code === 0 ? 0 : Math.fround(2 ** ((code - CODE_OF_ONE) / STEPS_PER_OCTAVE));
}
