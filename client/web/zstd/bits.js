// Bits of a stream that is read from its end: the last byte's highest bit marks where they begin.

import { check, highestBit } from "./error.js";

/** Reads bits from the end of `bytes[start..end]` towards its start. */
export class BackwardBits {
  constructor(bytes, start, end) {
    check(end > start && bytes[end - 1] !== 0, "a bit stream has no first bit");
    this.bytes = bytes;
    this.start = start;
    /** Bits that are left. */
    this.left = 8 * (end - start - 1) + highestBit(bytes[end - 1]);
  }

  /** The next `count` bits, at most 31, the first one highest. */
  take(count) {
    check(count <= this.left, "a bit stream is too short");
    if (count <= 16) return this.part(count);
    const high = this.part(count - 16);
    return high * 0x10000 + this.part(16);
  }

  /** The next `count` bits, at most 16, which are there. */
  part(count) {
    this.left -= count;
    const at = this.start + (this.left >> 3);
    const bytes = this.bytes;
    // Bytes past the end of `bytes` count as 0: none of their bits is asked for.
    const word = bytes[at] | (bytes[at + 1] << 8) | (bytes[at + 2] << 16);
    return (word >>> (this.left & 7)) & ((1 << count) - 1);
  }
}
