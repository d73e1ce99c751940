// Faults of a chunk, as `ChunkError` of the Rust decoder has them, with the same words.

/**
 * Why bytes are not a chunk. Nothing is decoded in part: an error means nothing.
 *
 * `code` is `truncated`, `trailing`, `magic`, `version`, `unknown_kind`, `kind`, `out_of_range`, `bad_number`, `section`, `order`,
 * `compression` or `digest`; `section` and `what` say where, if it is at one place.
 */
export class ChunkError extends Error {
  constructor(code, message, { section, what, cause } = {}) {
    super(message, cause === undefined ? undefined : { cause });
    this.name = "ChunkError";
    this.code = code;
    this.section = section;
    this.what = what;
  }
}

/** `value` if it lies in `min..=max`. */
export function inRange(section, what, value, min, max) {
  if (value >= min && value <= max) return value;
  const message = `${section}: ${what} is ${value}, allowed is ${min}..=${max}`;
  throw new ChunkError("out_of_range", message, { section, what });
}

/** Throws on the first number that is not finite. */
export function allFinite(section, what, numbers) {
  allNumbers(section, what, numbers, "a finite number", Number.isFinite);
}

/** Throws on the first number that is not `good`, or not `wanted` in words. */
export function allNumbers(section, what, numbers, wanted, good) {
  for (let index = 0; index < numbers.length; index++) {
    if (good(numbers[index])) continue;
    const message = `${section}: ${what} number ${index} is ${numbers[index]}, wanted ${wanted}`;
    throw new ChunkError("bad_number", message, { section, what });
  }
}

/** The error that number `index` of `what` is not in order. */
export function orderError(section, what, index) {
  return new ChunkError("order", `${section}: ${what} number ${index} does not ascend`, { section, what });
}

/** Throws on the first key that is not larger than the one before. */
export function allAscending(section, what, keys) {
  for (let index = 1; index < keys.length; index++) {
    if (keys[index - 1] >= keys[index]) throw orderError(section, what, index);
  }
}
