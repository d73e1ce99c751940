// Unpacks a zstd frame (RFC 8878) of a known length, as chunks have them: without checksum, content size and dictionary. Every
// count is checked before it is used, nothing is allocated beyond the length that was asked for, and each step of a loop reads or
// writes a byte: a damaged frame is an error after a short time.

import { check } from "./error.js";
import { readLiterals } from "./literals.js";
import { unpackSequences } from "./sequences.js";

export { ZstdError } from "./error.js";

const MAGIC = [0x28, 0xb5, 0x2f, 0xfd];
const HEADER_BYTES = 6;
const BLOCK_HEADER_BYTES = 3;
/** Most bytes of a block, before and after. */
const BLOCK_BYTES_MAX = 128 * 1024;
const RAW = 0;
const REPEATED = 1;
const PACKED = 2;

/** The `rawBytes` bytes that the frame `stored` unpacks to; throws `ZstdError` if it does not, or to more or fewer. */
export function unpack(stored, rawBytes) {
  check(stored.length >= HEADER_BYTES, "the frame is cut off");
  check(MAGIC.every((byte, index) => stored[index] === byte), "the bytes are no zstd frame");
  check(stored[4] === 0, "the frame has a checksum, a content size or a dictionary");
  const blockMax = Math.min(BLOCK_BYTES_MAX, windowOf(stored[5]));
  const out = new Uint8Array(rawBytes);
  const state = { length: 0, offsets: [1, 4, 8], tables: [], tree: null };
  let at = HEADER_BYTES;
  for (let isLast = false; !isLast; ) {
    check(at + BLOCK_HEADER_BYTES <= stored.length, "a block is cut off");
    const header = stored[at] | (stored[at + 1] << 8) | (stored[at + 2] << 16);
    isLast = (header & 1) === 1;
    const [kind, size] = [(header >> 1) & 3, header >> 3];
    at += BLOCK_HEADER_BYTES;
    const end = at + (kind === REPEATED ? 1 : size);
    check(size <= blockMax && end <= stored.length, "a block is too long or cut off");
    unpackBlock(stored, at, end, { kind, size, blockMax }, state, out);
    at = end;
  }
  check(at === stored.length, "bytes follow the frame");
  check(state.length === rawBytes, "the frame is too short");
  return out;
}

/** Bytes of the window of a descriptor. */
function windowOf(descriptor) {
  const base = 2 ** (10 + (descriptor >> 3));
  return base + (base / 8) * (descriptor & 7);
}

function unpackBlock(stored, start, end, { kind, size, blockMax }, state, out) {
  if (kind === PACKED) {
    const limit = Math.min(state.length + blockMax, out.length);
    const { literals, tree, end: sequences } = readLiterals(stored, start, end, blockMax, state.tree);
    state.tree = tree;
    unpackSequences(stored, sequences, end, literals, state, out, limit);
    return;
  }
  check(kind === RAW || kind === REPEATED, "a block's kind is unknown");
  check(state.length + size <= out.length, "the frame is too long");
  if (kind === RAW) out.set(stored.subarray(start, end), state.length);
  else out.fill(stored[start], state.length, state.length + size);
  state.length += size;
}
