// Unpacks a zstd frame (RFC 8878) of a known length, as chunks have them: without checksum and dictionary. Every count is checked
// before it is used, nothing is allocated beyond the length that was asked for and a block's literals, and every loop has an end that
// is known before it begins: a damaged frame is an error after a short time.

import { check } from "./error.js";
import { readLiterals } from "./literals.js";
import { unpackSequences } from "./sequences.js";

export { ZstdError } from "./error.js";

const MAGIC = [0x28, 0xb5, 0x2f, 0xfd];
/** Magic, descriptor. */
const START_BYTES = 5;
const BLOCK_HEADER_BYTES = 3;
/** Most bytes of a block, before and after. */
const BLOCK_BYTES_MAX = 128 * 1024;
const WINDOW_LOG_MAX = 31;
/** Bits of the descriptor for a dictionary, a checksum, and what no frame has yet. */
const NEVER = 0x0f;
const ONE_SEGMENT = 0x20;
const RAW = 0;
const REPEATED = 1;
const PACKED = 2;

/** The `rawBytes` bytes that the frame `stored` unpacks to; throws `ZstdError` if it does not, or to more or fewer. */
export function unpack(stored, rawBytes) {
  const header = readHeader(stored, rawBytes);
  const out = new Uint8Array(rawBytes);
  const state = { length: 0, offsets: [1, 4, 8], tables: [], tree: null };
  let at = header.end;
  for (let isLast = false; !isLast; ) {
    check(at + BLOCK_HEADER_BYTES <= stored.length, "a block is cut off");
    const block = stored[at] | (stored[at + 1] << 8) | (stored[at + 2] << 16);
    isLast = (block & 1) === 1;
    const [kind, size] = [(block >> 1) & 3, block >> 3];
    at += BLOCK_HEADER_BYTES;
    const end = at + (kind === REPEATED ? 1 : size);
    check(size <= header.blockMax && end <= stored.length, "a block is too long or cut off");
    unpackBlock(stored, at, end, { kind, size, blockMax: header.blockMax }, state, out);
    at = end;
  }
  check(at === stored.length, "bytes follow the frame");
  check(state.length === rawBytes, "the frame is too short");
  return out;
}

/** Most bytes of a block, and where the header ends. A content size is none of those that chunks have, but does no harm. */
function readHeader(stored, rawBytes) {
  check(stored.length >= START_BYTES, "the frame is cut off");
  check(MAGIC.every((byte, index) => stored[index] === byte), "the bytes are no zstd frame");
  const descriptor = stored[4];
  check((descriptor & NEVER) === 0, "the frame has a checksum or a dictionary");
  const isOneSegment = (descriptor & ONE_SEGMENT) !== 0;
  const sizeBytes = [isOneSegment ? 1 : 0, 2, 4, 8][descriptor >> 6];
  const sizeAt = START_BYTES + (isOneSegment ? 0 : 1);
  const end = sizeAt + sizeBytes;
  check(end <= stored.length, "the frame is cut off");
  let size = sizeBytes === 2 ? 256 : 0;
  for (let index = 0; index < sizeBytes; index++) size += stored[sizeAt + index] * 2 ** (8 * index);
  check(sizeBytes === 0 || size === rawBytes, "the frame has another content size");
  const window = isOneSegment ? size : windowOf(stored[START_BYTES]);
  return { blockMax: Math.min(BLOCK_BYTES_MAX, window), end };
}

/** Bytes of the window of a descriptor. */
function windowOf(descriptor) {
  const log = 10 + (descriptor >> 3);
  check(log <= WINDOW_LOG_MAX, "the window is too large");
  const base = 2 ** log;
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
