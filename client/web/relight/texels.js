// Lightmap texels that hold irradiance: receivers' own, and empty ones near them; twin of proto/src/relight/texels.rs and of
// client/src/passes/atlas/texels.rs.

import { Growing } from "./growing.js";
import { NO_SLOT } from "./slots.js";

// Empty texels as far as this from a receiver are filled.
const EXTENSION_TEXELS = 4;
// Distance of the texels whose light a texel takes that has only a stand-in.
const BLENDED_TEXELS = 2;
// Kinds of a texel: nothing, the light of others; more for a receiver's own.
const NOTHING = 0;
const FILLED = -1;

/** Kind of a receiver's own texel, exact in f32. */
function kindOfReceiver(links, edge) {
  return 1 + (links % 16) + 16 * edge;
}

/** Texels that hold irradiance, block after block, row after row: the mean over the slots of each among `sources`. */
export class AtlasTexels {
  #texels = new Growing(Uint32Array);
  #sources = new Growing(Uint32Array);
  #kind = new Float32Array(1);
  #kindBits = new Uint32Array(this.#kind.buffer);

  #slots;
  #receivers;

  constructor(layout, slots, receivers) {
    this.#slots = slots;
    this.#receivers = receivers;
    layout.blocks.forEach((block, index) => {
      for (let y = 0; y < block.size[1]; y++) {
        for (let x = 0; x < block.size[0]; x++) {
          this.#push(index, block, x, y);
        }
      }
    });
    // Five words each, as shaders read them: column, row, first source, page and sources, bits of the kind.
    this.texels = this.#texels.finish();
    this.sources = this.#sources.finish();
  }

  get count() {
    return this.texels.length / 5;
  }

  #push(index, block, x, y) {
    const first = this.#sources.length;
    this.#kind[0] = this.#pushSources(index, x, y);
    const count = this.#sources.length - first;
    if (count > 0) {
      const packed = block.page + count * 2 ** 24;
      this.#texels.extend([block.origin[0] + x, block.origin[1] + y, first, packed, this.#kindBits[0]]);
    }
  }

  /** Adds the slots whose mean light a texel holds, and answers its kind. */
  #pushSources(block, x, y) {
    const first = this.#sources.length;
    if (this.#slots.hasSides && this.#slots.standing(block, x, y) !== NO_SLOT && this.#isAmidStandIns(block, x, y)) {
      this.#pushStanding(block, x, y);
      return FILLED;
    }
    for (let ring = 0; ring <= EXTENSION_TEXELS; ring++) {
      this.#pushRing(block, x, y, ring);
      if (this.#sources.length > first) {
        const slot = this.#sources.get(first);
        return ring === 0 ? kindOfReceiver(this.#receivers.links[slot], this.#receivers.edge[slot]) : FILLED;
      }
    }
    return NOTHING;
  }

  /** Whether a texel, or one beside it on its side of every wall, has no more than a stand-in. */
  #isAmidStandIns(block, x, y) {
    for (let dy = -1; dy <= 1; dy++) {
      for (let dx = -1; dx <= 1; dx++) {
        const [column, row] = [x + dx, y + dy];
        const isOfSide = this.#slots.areOfOneSide(block, x, y, column, row);
        const isAbsent = this.#slots.slot(block, column, row) === NO_SLOT;
        if (isOfSide && isAbsent && this.#slots.standing(block, column, row) !== NO_SLOT) {
          return true;
        }
      }
    }
    return false;
  }

  /**
   * Adds the receivers that stand for a texel and for those around it on its side of every wall: their mean hides the steps
   * between what two stand for.
   */
  #pushStanding(block, x, y) {
    for (const dy of [-BLENDED_TEXELS, 0, BLENDED_TEXELS]) {
      for (const dx of [-BLENDED_TEXELS, 0, BLENDED_TEXELS]) {
        if (this.#slots.areOfOneSide(block, x, y, x + dx, y + dy)) {
          this.#pushSlot(block, x + dx, y + dy);
        }
      }
    }
  }

  /** Adds the receivers at Chebyshev distance `ring` from a texel, in rows. */
  #pushRing(block, x, y, ring) {
    for (let row = y - ring; row <= y + ring; row++) {
      const onEdge = row === y - ring || row === y + ring;
      const step = onEdge || ring === 0 ? 1 : 2 * ring;
      for (let column = x - ring; column <= x + ring; column += step) {
        this.#pushSlot(block, column, row);
      }
    }
  }

  #pushSlot(block, x, y) {
    const slot = this.#slots.standing(block, x, y);
    if (slot !== NO_SLOT) {
      this.#sources.push(slot);
    }
  }
}
