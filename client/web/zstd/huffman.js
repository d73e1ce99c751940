// Huffman codes of literals.

import { BackwardBits } from "./bits.js";
import { check, highestBit } from "./error.js";
import { readTable } from "./fse.js";

/** Most bits of a code. */
const BITS_MAX = 11;
/** Most bits of a state of the table that weights are coded with. */
const WEIGHT_LOG_MAX = 6;
/** Symbols whose weights are stored; that of the last follows from them. */
const WEIGHTS_MAX = 255;
/** First byte from which on weights are stored as they are. */
const PLAIN = 128;

/** Reads a tree from `bytes[start..end]`; gives `{tree: {log, symbols, bits}, end}`. */
export function readTree(bytes, start, end) {
  check(start < end, "a Huffman tree is cut off");
  const head = bytes[start];
  const isPlain = head >= PLAIN;
  const count = head - PLAIN + 1;
  const last = start + 1 + (isPlain ? (count + 1) >> 1 : head);
  check(last <= end, "a Huffman tree is cut off");
  const weights = isPlain ? plainWeights(bytes, start + 1, count) : codedWeights(bytes, start + 1, last);
  return { tree: treeOf(weights), end: last };
}

function plainWeights(bytes, start, count) {
  const weight = (index) => (bytes[start + (index >> 1)] >> (index & 1 ? 0 : 4)) & 15;
  return Array.from({ length: count }, (_, index) => weight(index));
}

/** Weights of two states in turn, until the bits do not last for the next one. */
function codedWeights(bytes, start, end) {
  const { table, end: bitsStart } = readTable(bytes, start, end, WEIGHT_LOG_MAX, 255);
  const reader = new BackwardBits(bytes, bitsStart, end);
  const states = [reader.take(table.log), reader.take(table.log)];
  const weights = [];
  for (let turn = 0; ; turn ^= 1) {
    check(weights.length < WEIGHTS_MAX - 1, "a Huffman tree has too many weights");
    const state = states[turn];
    weights.push(table.symbols[state]);
    if (table.bits[state] > reader.left) {
      weights.push(table.symbols[states[turn ^ 1]]);
      return weights;
    }
    states[turn] = table.next[state] + reader.take(table.bits[state]);
  }
}

/** Table of codes: those of the lowest weight first, which are the longest. A weight w stands for 2^(w − 1) places. */
function treeOf(weights) {
  const placesOf = (weight) => (weight > 0 ? 1 << (weight - 1) : 0);
  check(weights.every((weight) => weight <= BITS_MAX), "a Huffman code is too long");
  const sum = weights.reduce((sum, weight) => sum + placesOf(weight), 0);
  check(sum > 0, "a Huffman tree has no codes");
  const log = highestBit(sum) + 1;
  const rest = (1 << log) - sum;
  check(log <= BITS_MAX && (rest & (rest - 1)) === 0, "a Huffman tree is not complete");
  const all = [...weights, highestBit(rest) + 1];
  const tree = { log, symbols: new Uint8Array(1 << log), bits: new Uint8Array(1 << log) };
  let place = 0;
  for (let weight = 1; weight <= log; weight++) {
    all.forEach((own, symbol) => {
      if (own !== weight) return;
      tree.symbols.fill(symbol, place, place + placesOf(weight));
      tree.bits.fill(log + 1 - weight, place, place + placesOf(weight));
      place += placesOf(weight);
    });
  }
  check(place === 1 << log, "a Huffman tree is not complete");
  return tree;
}

/** Reads the codes of `bytes[start..end]` into `out`, whose length is that of the stream. */
export function readStream(bytes, start, end, tree, out) {
  const reader = new BackwardBits(bytes, start, end);
  const { log, symbols, bits } = tree;
  const mask = (1 << log) - 1;
  const length = out.length;
  let left = reader.left;
  let index = 0;
  while (index < length && left >= log) {
    const low = left - log;
    const at = start + (low >> 3);
    const state = ((bytes[at] | (bytes[at + 1] << 8) | (bytes[at + 2] << 16)) >>> (low & 7)) & mask;
    out[index++] = symbols[state];
    left -= bits[state];
  }
  for (; index < length; index++) {
    // Fewer bits than the longest code has: zeros stand for those that are not there.
    const word = bytes[start] | (left > 8 ? bytes[start + 1] << 8 : 0);
    const state = ((word & ((1 << left) - 1)) << (log - left)) & mask;
    out[index] = symbols[state];
    left -= bits[state];
    check(left >= 0, "a stream of literals is too short");
  }
  check(left === 0, "a stream of literals is too long");
}
