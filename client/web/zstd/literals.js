// Literals of a block: stored, repeated, or Huffman coded.

import { check } from "./error.js";
import { readStream, readTree } from "./huffman.js";

const RAW = 0;
const REPEATED = 1;
const CODED = 2;

/** Reads literals at `start`; gives `{literals, tree, end}`. `tree` is that of the blocks before, `countMax` their most. */
export function readLiterals(bytes, start, end, countMax, tree) {
  check(start < end, "literals are cut off");
  const kind = bytes[start] & 3;
  return kind <= REPEATED
    ? readPlain(bytes, start, end, countMax, kind, tree)
    : readCoded(bytes, start, end, countMax, kind, tree);
}

function readPlain(bytes, start, end, countMax, kind, tree) {
  const format = (bytes[start] >> 2) & 3;
  const headBytes = [1, 2, 1, 3][format];
  const content = start + headBytes;
  check(content <= end, "literals are cut off");
  const head = bytes[start] | (bytes[start + 1] << 8) | (bytes[start + 2] << 16);
  const count = [(head & 0xff) >> 3, (head & 0xffff) >> 4, (head & 0xff) >> 3, head >> 4][format];
  const last = content + (kind === RAW ? count : 1);
  check(count <= countMax && last <= end, "there are too many literals");
  const literals =
    kind === RAW ? bytes.subarray(content, last) : new Uint8Array(count).fill(bytes[content]);
  return { literals, tree, end: last };
}

function readCoded(bytes, start, end, countMax, kind, before) {
  const format = (bytes[start] >> 2) & 3;
  const headBytes = [3, 3, 4, 5][format];
  const content = start + headBytes;
  check(content <= end, "literals are cut off");
  const width = [10, 10, 14, 18][format];
  const field = (bit) => bitsAt(bytes, start, bit, width);
  const [count, storedBytes] = [field(4), field(4 + width)];
  const last = content + storedBytes;
  check(count <= countMax && last <= end, "there are too many literals");
  let [tree, streams] = [before, content];
  if (kind === CODED) ({ tree, end: streams } = readTree(bytes, content, last));
  check(tree !== null, "literals have no Huffman tree");
  const literals = new Uint8Array(count);
  if (format === 0) readStream(bytes, streams, last, tree, literals);
  else readFour(bytes, streams, last, tree, literals);
  return { literals, tree, end: last };
}

/** The number of `width` bits, at most 18, from bit `first` of `bytes[start..]` on. */
function bitsAt(bytes, start, first, width) {
  const at = start + (first >> 3);
  const word = bytes[at] | (bytes[at + 1] << 8) | (bytes[at + 2] << 16);
  return (word >>> (first & 7)) & ((1 << width) - 1);
}

/** Four streams, of which the first three have one length; theirs in bytes come first. */
function readFour(bytes, start, end, tree, literals) {
  check(start + 6 <= end, "literals are cut off");
  const each = (literals.length + 3) >> 2;
  check(3 * each <= literals.length, "there are too few literals for four streams");
  let from = start + 6;
  for (let stream = 0; stream < 4; stream++) {
    const size = bytes[start + 2 * stream] | (bytes[start + 2 * stream + 1] << 8);
    const to = stream < 3 ? from + size : end;
    check(to <= end, "a stream of literals is cut off");
    const out = literals.subarray(stream * each, stream < 3 ? (stream + 1) * each : literals.length);
    readStream(bytes, from, to, tree, out);
    from = to;
  }
}
