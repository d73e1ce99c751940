// Sequences of a block: so many literals, then so many bytes that were there before.

import { BackwardBits } from "./bits.js";
import { check } from "./error.js";
import { readTable, tableOfCounts, tableOfOne } from "./fse.js";

/** Bits that codes of lengths are followed by, and the length that those are added to. */
const LITERAL_BITS = [...Array(16).fill(0), 1, 1, 1, 1, 2, 2, 3, 3, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16];
const MATCH_BITS = [
  ...Array(32).fill(0), 1, 1, 1, 1, 2, 2, 3, 3, 4, 4, 5, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16,
];
const LITERAL_BASE = basesOf(LITERAL_BITS, 0);
const MATCH_BASE = basesOf(MATCH_BITS, 3);

function basesOf(bits, first) {
  let next = first;
  return bits.map((count) => {
    const base = next;
    next += 2 ** count;
    return base;
  });
}

/** Tables of a block in their order: lengths of literals, offsets, lengths of matches. */
const FIELDS = [
  {
    logMax: 9,
    symbolMax: 35,
    usual: tableOfCounts(
      [4, 3, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 2, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 2, 3, 2, 1, 1, 1, 1, 1, -1, -1, -1, -1],
      6,
    ),
  },
  {
    logMax: 8,
    symbolMax: 31,
    usual: tableOfCounts(
      [1, 1, 1, 1, 1, 1, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1],
      5,
    ),
  },
  {
    logMax: 9,
    symbolMax: 52,
    usual: tableOfCounts(
      [
        1, 4, 3, 2, 2, 2, 2, 2, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1,
        1, 1, 1, 1, 1, 1, 1, 1, 1, -1, -1, -1, -1, -1, -1, -1,
      ],
      6,
    ),
  },
];

const USUAL = 0;
const ONE = 1;
const OWN = 2;

/** How a table is stored: `{table, end}`; `before` is that of the block before. */
function readField(bytes, start, end, mode, { logMax, symbolMax, usual }, before) {
  switch (mode) {
    case USUAL:
      return { table: usual, end: start };
    case ONE:
      check(start < end && bytes[start] <= symbolMax, "a table has a symbol that there is not");
      return { table: tableOfOne(bytes[start]), end: start + 1 };
    case OWN:
      return readTable(bytes, start, end, logMax, symbolMax);
    default:
      check(before !== undefined, "a table is to be repeated, and there is none");
      return { table: before, end: start };
  }
}

/** Number of sequences, and where it ends. */
function readCount(bytes, start, end) {
  check(start < end, "sequences are cut off");
  const first = bytes[start];
  const headBytes = first < 128 ? 1 : first < 255 ? 2 : 3;
  check(start + headBytes <= end, "sequences are cut off");
  if (headBytes === 1) return [first, start + 1];
  if (headBytes === 2) return [((first - 128) << 8) + bytes[start + 1], start + 2];
  return [bytes[start + 1] + (bytes[start + 2] << 8) + 0x7f00, start + 3];
}

/**
 * Reads the sequences of `bytes[start..end]` and puts literals and matches to `out` from `state.length` on, to `limit` at most.
 * `state` has the bytes written, offsets of the sequences before, and tables of the blocks before.
 */
export function unpackSequences(bytes, start, end, literals, state, out, limit) {
  const [count, fields] = readCount(bytes, start, end);
  if (count === 0) {
    check(fields === end, "bytes follow a block's literals");
    putRest(literals, 0, state, out, limit);
    return;
  }
  check(fields < end && (bytes[fields] & 3) === 0, "sequences are cut off, or their modes unknown");
  let at = fields + 1;
  state.tables = FIELDS.map((field, index) => {
    const mode = (bytes[fields] >> (6 - 2 * index)) & 3;
    const read = readField(bytes, at, end, mode, field, state.tables[index]);
    at = read.end;
    return read.table;
  });
  run(new BackwardBits(bytes, at, end), count, literals, state, out, limit);
}

function run(reader, count, literals, state, out, limit) {
  const [ofLiterals, ofOffsets, ofMatches] = state.tables;
  let literalState = reader.take(ofLiterals.log);
  let offsetState = reader.take(ofOffsets.log);
  let matchState = reader.take(ofMatches.log);
  let used = 0;
  for (let index = 0; index < count; index++) {
    const offsetCode = ofOffsets.symbols[offsetState];
    const offsetValue = 2 ** offsetCode + reader.take(offsetCode);
    const matchCode = ofMatches.symbols[matchState];
    const length = MATCH_BASE[matchCode] + reader.take(MATCH_BITS[matchCode]);
    const literalCode = ofLiterals.symbols[literalState];
    const own = LITERAL_BASE[literalCode] + reader.take(LITERAL_BITS[literalCode]);
    if (index + 1 < count) {
      literalState = ofLiterals.next[literalState] + reader.take(ofLiterals.bits[literalState]);
      matchState = ofMatches.next[matchState] + reader.take(ofMatches.bits[matchState]);
      offsetState = ofOffsets.next[offsetState] + reader.take(ofOffsets.bits[offsetState]);
    }
    const offset = offsetOf(offsetValue, own, state.offsets);
    check(used + own <= literals.length, "sequences have more literals than there are");
    check(state.length + own + length <= limit, "a block is too long");
    check(offset > 0 && offset <= state.length + own, "a match lies before the first byte");
    putLiterals(literals, used, own, state, out);
    used += own;
    putMatch(offset, length, state, out);
  }
  check(reader.left === 0, "bits follow the last sequence");
  putRest(literals, used, state, out, limit);
}

/** Distance of a match: values above 3 are new, others name one of the last three. */
function offsetOf(value, literalCount, offsets) {
  if (value > 3) {
    offsets.unshift(value - 3);
    offsets.pop();
    return offsets[0];
  }
  const place = value - 1 + (literalCount === 0 ? 1 : 0);
  if (place === 0) return offsets[0];
  const offset = place === 3 ? offsets[0] - 1 : offsets[place];
  offsets.splice(Math.min(place, 2), 1);
  offsets.unshift(offset);
  return offset;
}

function putLiterals(literals, from, count, state, out) {
  const to = state.length;
  if (count < 32) for (let index = 0; index < count; index++) out[to + index] = literals[from + index];
  else out.set(literals.subarray(from, from + count), to);
  state.length += count;
}

function putMatch(offset, count, state, out) {
  const to = state.length;
  if (offset >= count && count >= 32) out.copyWithin(to, to - offset, to - offset + count);
  // A match may run into itself: byte by byte.
  else for (let index = 0; index < count; index++) out[to + index] = out[to + index - offset];
  state.length += count;
}

function putRest(literals, used, state, out, limit) {
  const count = literals.length - used;
  check(state.length + count <= limit, "a block is too long");
  putLiterals(literals, used, count, state, out);
}
