// Block and texel → slot; twin of proto/src/relight/slots.rs.

import { Inconsistent } from "./inconsistent.js";

/** Slot of a texel whose receiver no cluster has: no light reaches it, and it sends none. */
export const DARK = 0xfffffffe;
/** Most texels of all blocks together. */
export const MAX_TEXELS = 2 ** 27;
/** Absent slot, side or texel, as the calls below answer. */
export const NO_SLOT = -1;

// Marks a texel without a receiver.
const NONE = 0xffffffff;
// Bit of a slot whose receiver only stands for that of the texel.
const STANDS_IN = 0x80000000;

/** Slot of every texel of every block. */
export class SlotTable {
  #sizes = [];
  #firsts = [];
  #byKey = new Map();
  #slots;
  // Side of walls that each texel is of; null where no receiver stands for others.
  #sides = null;

  /** Blocks by key and size in texels, all of their texels without receiver. */
  constructor(blocks) {
    let texels = 0;
    for (const [index, { key, size }] of blocks.entries()) {
      this.#sizes.push(size);
      this.#firsts.push(texels);
      texels += size[0] * size[1];
      if (texels > MAX_TEXELS) {
        throw new Inconsistent(`block ${index}`, `brings the texels above ${MAX_TEXELS}`);
      }
      if (this.#byKey.has(key)) {
        throw new Inconsistent(`block ${index}`, "has the key of another block");
      }
      this.#byKey.set(key, index);
    }
    this.#slots = new Uint32Array(texels).fill(NONE);
  }

  /** Index of a block by its key, in the order given; undefined where there is none. */
  blockIndex(key) {
    return this.#byKey.get(key);
  }

  /** Indices of blocks; errs when there is no block of a key. */
  blockIndices(keys) {
    return Array.from(keys, (key) => {
      const index = this.#byKey.get(key);
      if (index === undefined) {
        const name = key.toString(16).padStart(16, "0");
        throw new Error(`names block ${name}, which the manifest lacks`);
      }
      return index;
    });
  }

  /** Slot of a receiver; NO_SLOT when the texel is outside of its block or has no receiver of its own. */
  slot(block, x, y) {
    const index = this.#texelIndex(block, x, y);
    const slot = index < 0 ? NONE : this.#slots[index];
    return slot >= STANDS_IN ? NO_SLOT : slot;
  }

  /** Slot of the receiver of a texel, or of one that stands for it; NO_SLOT where there is neither. */
  standing(block, x, y) {
    const index = this.#texelIndex(block, x, y);
    const slot = index < 0 ? NONE : this.#slots[index];
    return slot === NONE ? NO_SLOT : slot >= STANDS_IN ? slot - STANDS_IN : slot;
  }

  /** Calls `visit` with slot, block and texel of each receiver, block after block, row after row. */
  forEachReceiver(visit) {
    this.#sizes.forEach(([width, height], block) => {
      let index = this.#firsts[block];
      for (let y = 0; y < height; y++) {
        for (let x = 0; x < width; x++, index++) {
          const slot = this.#slots[index];
          if (slot < STANDS_IN) visit(slot, block, x, y);
        }
      }
    });
  }

  /** Enters a receiver; its texel must be inside the block and free. */
  enter(block, x, y, slot) {
    const index = this.#texelIndex(block, x, y);
    if (index < 0) {
      throw new Error("lies outside its block");
    }
    if (this.#slots[index] !== NONE) {
      throw new Error("lies on the texel of another receiver");
    }
    this.#slots[index] = slot;
  }

  /** Some receiver stands for another. */
  get hasSides() {
    return this.#sides !== null;
  }

  /** Whether two texels of a block are of one side of walls, as far as sides are known. */
  areOfOneSide(block, x, y, otherX, otherY) {
    const a = this.#side(block, x, y);
    return a !== NONE && a === this.#side(block, otherX, otherY);
  }

  /**
   * Slot of the receiver that stands for that of a texel whose surroundings are all of its side, so that no wall cuts the
   * texel; NO_SLOT for all others.
   */
  standingInside(block, x, y) {
    const index = this.#texelIndex(block, x, y);
    const own = index < 0 ? NONE : this.#slots[index];
    if (own === NONE || own < STANDS_IN) {
      return NO_SLOT;
    }
    for (let dy = -1; dy <= 1; dy++) {
      for (let dx = -1; dx <= 1; dx++) {
        if (!this.areOfOneSide(block, x, y, x + dx, y + dy)) {
          return NO_SLOT;
        }
      }
    }
    return own - STANDS_IN;
  }

  /** Says of which side of all walls a texel is; texels outside of their block are left out. */
  setSide(block, x, y, side) {
    this.#sides ??= new Uint32Array(this.#slots.length).fill(NONE);
    const index = this.#texelIndex(block, x, y);
    if (index >= 0) {
      this.#sides[index] = side;
    }
  }

  /** Makes the receiver at `slot` stand for that of a texel which has none; texels outside of their block are left out. */
  standIn(block, x, y, slot) {
    const index = this.#texelIndex(block, x, y);
    if (index >= 0 && this.#slots[index] === NONE) {
      this.#slots[index] = slot + STANDS_IN;
    }
  }

  #side(block, x, y) {
    const index = this.#sides === null ? -1 : this.#texelIndex(block, x, y);
    return index < 0 ? NONE : this.#sides[index];
  }

  #texelIndex(block, x, y) {
    const size = this.#sizes[block];
    if (size === undefined || x < 0 || y < 0 || x >= size[0] || y >= size[1]) {
      return -1;
    }
    return this.#firsts[block] + y * size[0] + x;
  }
}
