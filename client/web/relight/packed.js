// Factors as run times keep them: whole numbers of a step in as few bits as hold them; twin of proto/src/relight/packed.rs, which
// shows the layout.

import { fround, rounded } from "./numbers.js";

/** Numbers of a group. */
export const GROUP = 8;
// Words of a group by the bits of its numbers.
const OF_4 = 1;
const OF_8 = 2;
const OF_16 = 4;
const OF_F32 = 8;

/** The whole number whose product with step and scale is `value` to the bit; else the quotient. */
export function numberOf(value, step, scale) {
  const quotient = fround(value / fround(step * scale));
  const whole = rounded(quotient);
  return fround(fround(whole * step) * scale) === value ? whole : quotient;
}

/** A step that numbers can be divided by: 1 where there is none. */
export function stepOf(steps, rank) {
  const step = steps[rank];
  return step > 0 ? step : 1;
}

/** Words of a group that holds a number. */
function wordsFor(number) {
  const size = Math.abs(number);
  if (!Number.isInteger(number) || size > 32767) {
    return OF_F32;
  }
  return size <= 7 ? OF_4 : size <= 127 ? OF_8 : OF_16;
}

const asFloat = new Float32Array(1);
const asWord = new Uint32Array(asFloat.buffer);

/** Writes a group of eight numbers in so many words; answers where the next one begins. */
function put(words, at, numbers, count) {
  if (count === OF_F32) {
    for (let i = 0; i < GROUP; i++) {
      asFloat[0] = numbers[i];
      words[at + i] = asWord[0];
    }
    return at + count;
  }
  const bits = (32 * count) / GROUP;
  const perWord = GROUP / count;
  const mask = 0xffffffff >>> (32 - bits);
  for (let word = 0; word < count; word++) {
    let sum = 0;
    for (let place = 0; place < perWord; place++) {
      sum |= (numbers[word * perWord + place] & mask) << (place * bits);
    }
    words[at + word] = sum;
  }
  return at + count;
}

/** Words that each column of ΣVᵀ needs for a group; `numbers` are rank-major. */
function wordsOfColumns(numbers, columns, rank) {
  const needed = new Uint8Array(columns).fill(OF_4);
  for (let i = 0; i < rank; i++) {
    for (let column = 0; column < columns; column++) {
      needed[column] = Math.max(needed[column], wordsFor(numbers[i * columns + column]));
    }
  }
  return needed;
}

/**
 * ΣVᵀ of so many columns and ranks, `numbers` rank-major: words, the order in which its columns stand, those of the widest class
 * first, of these those of the highest levels, and how it is packed.
 */
export function packVt(numbers, levels, rank) {
  const columns = levels.length;
  const needed = wordsOfColumns(numbers, columns, rank);
  const order = Uint32Array.from({ length: columns }, (_, column) => column);
  // Columns of 16 bits and of f32 are one class.
  const classOf = (column) => Math.min(needed[column], OF_16);
  order.sort((a, b) => classOf(b) - classOf(a) || levels[b] - levels[a] || a - b);
  const widest = needed.reduce((most, words) => Math.max(most, words), OF_4);
  const wideWords = Math.max(widest, OF_16);
  let wide = 0;
  let bytes = 0;
  for (const words of needed) {
    wide += words > OF_8 ? 1 : 0;
    bytes += words === OF_8 ? 1 : 0;
  }
  const groups = Math.ceil(rank / GROUP);
  const ofGroup = wide * wideWords + bytes * OF_8 + (columns - wide - bytes) * OF_4;
  const words = new Uint32Array(groups * ofGroup);
  const group = new Float32Array(GROUP);
  let at = 0;
  for (let first = 0; first < rank; first += GROUP) {
    for (const column of order) {
      for (let i = 0; i < GROUP; i++) {
        group[i] = first + i < rank ? numbers[(first + i) * columns + column] : 0;
      }
      at = put(words, at, group, needed[column] > OF_8 ? wideWords : needed[column]);
    }
  }
  return { words, order, packing: { len: words.length, wide, wideWords, bytes } };
}

/** U of so many ranks and rows, `numbers` row-major: words and how it is packed. */
export function packU(numbers, rank, rows) {
  const groups = Math.ceil(rank / GROUP);
  const needed = new Uint8Array(groups).fill(rows > 0 ? OF_4 : OF_8);
  for (let row = 0; row < rows; row++) {
    for (let i = 0; i < rank; i++) {
      const group = Math.floor(i / GROUP);
      needed[group] = Math.max(needed[group], wordsFor(numbers[row * rank + i]));
    }
  }
  let wide = groups;
  while (wide > 0 && needed[wide - 1] <= OF_8) {
    wide--;
  }
  const widest = needed.reduce((most, words) => Math.max(most, words), OF_8);
  const wideWords = Math.max(widest, OF_16);
  const words = new Uint32Array(rows * (wide * wideWords + (groups - wide) * OF_8));
  const group = new Float32Array(GROUP);
  let at = 0;
  for (let index = 0; index < groups; index++) {
    for (let row = 0; row < rows; row++) {
      for (let i = 0; i < GROUP; i++) {
        const place = index * GROUP + i;
        group[i] = place < rank ? numbers[row * rank + place] : 0;
      }
      at = put(words, at, group, index < wide ? wideWords : OF_8);
    }
  }
  return { words, packing: { len: words.length, wide, wideWords, bytes: 0 } };
}
