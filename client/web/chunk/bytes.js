// Little-endian reading; every length is checked before anything is taken or allocated.

import { ChunkError, allFinite } from "./error.js";

/** Reads from the front of some bytes; errors name `section`. */
export class Reader {
  constructor(section, bytes) {
    this.section = section;
    this.bytes = bytes;
    this.offset = 0;
  }

  /** The next `count` items of `size` bytes, as a view. */
  take(what, count, size = 1) {
    const { section, offset } = this;
    const left = this.bytes.length - offset;
    const wanted = count * size;
    if (wanted > left) {
      const message = `${section}: ${what} needs ${wanted} bytes at offset ${offset}, ${left} are left`;
      throw new ChunkError("truncated", message, { section, what });
    }
    this.offset += wanted;
    return this.bytes.subarray(offset, this.offset);
  }

  u8(what) {
    return this.take(what, 1)[0];
  }

  u16(what) {
    const bytes = this.take(what, 1, 2);
    return bytes[0] | (bytes[1] << 8);
  }

  u32(what) {
    const bytes = this.take(what, 1, 4);
    return (bytes[0] | (bytes[1] << 8) | (bytes[2] << 16) | (bytes[3] << 24)) >>> 0;
  }

  /** A finite number. */
  f32(what) {
    return this.f32s(what, 1)[0];
  }

  /** `count` finite numbers, as a Float32Array. */
  f32s(what, count) {
    const numbers = new Float32Array(copyOf(this.take(what, count, 4)));
    allFinite(this.section, what, numbers);
    return numbers;
  }

  /** `count` numbers of eight bytes, as a BigUint64Array. */
  u64s(what, count) {
    return new BigUint64Array(copyOf(this.take(what, count, 8)));
  }

  /** Throws if anything is left. */
  end() {
    const { section, offset } = this;
    const extra = this.bytes.length - offset;
    if (extra === 0) return;
    throw new ChunkError("trailing", `${section}: ${extra} bytes are left over at offset ${offset}`, { section });
  }
}

/** A buffer of its own with the bytes of a view, so that wider numbers are aligned in it. */
function copyOf(bytes) {
  return bytes.slice().buffer;
}
