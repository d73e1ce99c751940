// Guesses of a receiver's value, from neighbouring texels that are stored before it.

/** Pairs of opposite neighbours, in strides of the receiver's level: first the sides, then the corners. */
const SIDES = [[-1, 0], [1, 0], [0, -1], [0, 1]];
const CORNERS = [[-1, -1], [1, 1], [1, -1], [-1, 1]];
/** Most receivers that one is guessed from. */
const SOURCES_MAX = 4;

/** Sources of every receiver read so far. */
export class Predictor {
  /** Of up to `rows` receivers. */
  constructor(rows) {
    this.rowOf = new Map();
    this.sources = new Uint32Array(SOURCES_MAX * rows);
    this.counts = new Uint8Array(rows);
  }

  /** Takes in receivers `start..end`, all of `level`, which follow those taken in before. */
  extend({ block, texel }, start, end, level) {
    for (let row = start; row < end; row++) {
      const [x, y] = [texel[2 * row], texel[2 * row + 1]];
      let found = this.around(block[row], x, y, 1 << level);
      if (found.length === 0 && row > 0 && block[row - 1] === block[row]) found = [row - 1];
      this.sources.set(found, SOURCES_MAX * row);
      this.counts[row] = found.length;
      this.rowOf.set(place(block[row], x, y), row);
    }
  }

  /** Opposite sides, both known; else opposite corners, both known; else whatever side is known, else a corner. */
  around(block, x, y, stride) {
    const rowsAt = (offsets) => offsets.map(([dx, dy]) => this.rowAt(block, x + stride * dx, y + stride * dy));
    const all = [rowsAt(SIDES), rowsAt(CORNERS)];
    for (const [a, b, c, d] of all) {
      const pairs = [[a, b], [c, d]].filter(([one, other]) => one !== undefined && other !== undefined);
      if (pairs.length > 0) return pairs.flat();
    }
    for (const rows of all) {
      const known = rows.filter((row) => row !== undefined);
      if (known.length > 0) return known;
    }
    return [];
  }

  rowAt(block, x, y) {
    return x < 0 || y < 0 || x > 0xffff || y > 0xffff ? undefined : this.rowOf.get(place(block, x, y));
  }

  /** The rounded mean of the `values` of a receiver's sources, or 0 without any. */
  guess(row, values) {
    const count = this.counts[row];
    if (count === 0) return 0;
    let sum = 0;
    for (let index = 0; index < count; index++) sum += values[this.sources[SOURCES_MAX * row + index]];
    return Math.floor((sum + (count >> 1)) / count);
  }

  /** Turns `values[start..end]`, an Int32Array's differences from guesses, into the values. */
  restore(start, end, values) {
    for (let row = start; row < end; row++) values[row] = (this.guess(row, values) + values[row]) | 0;
  }
}

/** A block's texel as one number. */
function place(block, x, y) {
  return (block * 0x10000 + y) * 0x10000 + x;
}
