// Tables of finite state entropy: from a state to its symbol and the next state.

import { check, highestBit } from "./error.js";

/** Smallest logarithm of a table's size. */
const LOG_MIN = 5;

/** Table of 2^log states: `symbols`, bits to read next, and the state that those are added to. */
function tableOf(log) {
  const size = 1 << log;
  return { log, symbols: new Uint8Array(size), bits: new Uint8Array(size), next: new Uint16Array(size) };
}

/** Table of one state, which gives `symbol` for ever. */
export function tableOfOne(symbol) {
  const table = tableOf(0);
  table.symbols[0] = symbol;
  return table;
}

/** Table of symbols with these counts, of which −1 stands for less than one; their magnitudes sum up to 2^log. */
export function tableOfCounts(counts, log) {
  const table = tableOf(log);
  const size = 1 << log;
  const taken = new Uint16Array(counts.length);
  let last = size;
  counts.forEach((count, symbol) => {
    if (count === -1) table.symbols[--last] = symbol;
    taken[symbol] = Math.abs(count);
  });
  spread(table.symbols, counts, last);
  for (let state = 0; state < size; state++) {
    const place = taken[table.symbols[state]]++;
    const bits = log - highestBit(place);
    table.bits[state] = bits;
    table.next[state] = (place << bits) - size;
  }
  return table;
}

/** Spreads symbols with counts above 0 over the states below `last`. */
function spread(symbols, counts, last) {
  const size = symbols.length;
  const step = (size >> 1) + (size >> 3) + 3;
  let state = 0;
  counts.forEach((count, symbol) => {
    for (let index = 0; index < count; index++) {
      symbols[state] = symbol;
      // The step is odd and a state below `last` is left: the walk meets one.
      do state = (state + step) & (size - 1);
      while (state >= last);
    }
  });
}

/** Reads counts of symbols up to `symbolMax` from `bytes[start..end]`; gives the table and where its description ends. */
export function readTable(bytes, start, end, logMax, symbolMax) {
  const reader = new ForwardBits(bytes, start, end);
  const log = reader.take(4) + LOG_MIN;
  check(log <= logMax, "a table is too large");
  const counts = [];
  // Count of states that are left, and one more.
  let left = (1 << log) + 1;
  while (left > 1) {
    const count = readCount(reader, left) - 1;
    counts.push(count);
    left -= Math.abs(count);
    if (count === 0) readZeros(reader, counts);
    check(counts.length <= symbolMax + 1, "a table has too many symbols");
  }
  check(left === 1, "a table's counts are too large");
  return { table: tableOfCounts(counts, log), end: reader.byteEnd() };
}

/** A count and one, at most `left`: small ones take a bit less. */
function readCount(reader, left) {
  const bits = highestBit(left) + 1;
  const threshold = 1 << (bits - 1);
  const short = 2 * threshold - 1 - left;
  const low = reader.take(bits - 1);
  if (low < short) return low;
  const whole = low + (reader.take(1) ? threshold : 0);
  return whole >= threshold ? whole - short : whole;
}

/** Zeros that follow a zero, in twos of bits: 3 says that more follow. */
function readZeros(reader, counts) {
  for (let more = 3; more === 3; ) {
    more = reader.take(2);
    for (let index = 0; index < more; index++) counts.push(0);
    check(counts.length <= 256, "a table has too many symbols");
  }
}

/** Bits from the lowest of the first byte on. */
class ForwardBits {
  constructor(bytes, start, end) {
    this.bytes = bytes;
    this.bit = 8 * start;
    this.end = 8 * end;
  }

  take(count) {
    check(this.bit + count <= this.end, "a table is cut off");
    const at = this.bit >> 3;
    const word = this.bytes[at] | (this.bytes[at + 1] << 8) | (this.bytes[at + 2] << 16);
    const value = (word >>> (this.bit & 7)) & ((1 << count) - 1);
    this.bit += count;
    return value;
  }

  byteEnd() {
    return (this.bit + 7) >> 3;
  }
}
