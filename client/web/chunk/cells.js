// Whole numbers of very different sizes, in cells of similar ones: a shift for each cell, high parts as bytes, low parts as bits.

import { inRange } from "./error.js";
import { unzigzag } from "./ints.js";

/** Shift of a cell whose numbers are all zero; it has no high or low bits. */
const ZERO_CELL = 255;
const SHIFT_MAX = 24;

/** Gives cells back one by one. */
export class CellReader {
  /** Cells of the lengths that `eachLength` calls its function with; throws unless both readers have the bytes that they need. */
  constructor(high, low, eachLength) {
    let count = 0;
    eachLength(() => count++);
    this.shifts = high.take("shifts", count);
    let [index, highCount, lowBits] = [0, 0, 0];
    eachLength((length) => {
      const shift = this.shifts[index++];
      if (shift === ZERO_CELL) return;
      lowBits += length * inRange(high.section, "shift", shift, 0, SHIFT_MAX);
      highCount += length;
    });
    this.high = high.take("high parts", highCount);
    this.low = low.take("low parts", Math.ceil(lowBits / 8));
    this.cell = 0;
    this.highAt = 0;
    this.lowBit = 0;
  }

  /** Puts the next cell, of `length` numbers, to `values[at..]`; lengths must come as given to the constructor. */
  next(length, values, at) {
    const shift = this.shifts[this.cell++];
    if (shift === ZERO_CELL) {
      values.fill(0, at, at + length);
      return;
    }
    const mask = (1 << shift) - 1;
    const { high, low } = this;
    for (let index = 0; index < length; index++) {
      const first = this.lowBit >> 3;
      // At most 24 + 7 bits: four bytes, of which those past the end count as 0.
      const word = low[first] | (low[first + 1] << 8) | (low[first + 2] << 16) | (low[first + 3] << 24);
      const bits = (word >>> (this.lowBit & 7)) & mask;
      this.lowBit += shift;
      values[at + index] = unzigzag(((high[this.highAt++] << shift) | bits) >>> 0);
    }
  }
}
