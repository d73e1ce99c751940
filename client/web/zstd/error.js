// Fault of a zstd frame.

/** A frame that does not unpack; `message` says at which part. */
export class ZstdError extends Error {
  constructor(message) {
    super(message);
    this.name = "ZstdError";
  }
}

/** Throws unless `good`. */
export function check(good, message) {
  if (!good) throw new ZstdError(message);
}

/** Index of the highest bit of `value`, which is above 0. */
export function highestBit(value) {
  return 31 - Math.clz32(value);
}
