// Order of ΣVᵀ's columns in a rank, where each key has one: those that were large in the ranks before come first.

/** Bits of a column's size below one code. */
const SIZE_BITS = 4;
/** Of its size a column loses 2⁻³ from rank to rank. */
const FADING_BITS = 3;
/** The order is made anew at ranks that are multiples of this, and at the second and third rank. */
const RENEWED_EVERY = 4;
const OWN_MAX = 0xff_ffff;

/** Order of columns, from rank to rank. */
export class ColumnOrder {
  /** That of the first rank: by key. */
  constructor(columns) {
    /** Columns of the present rank, in stored order. */
    this.columns = Uint32Array.from({ length: columns }, (_, column) => column);
    this.sizes = new Uint32Array(columns);
    this.rank = 0;
  }

  /** Goes on to the next rank, `codes` being the present rank's, by key. */
  advance(codes) {
    const { sizes } = this;
    for (let column = 0; column < sizes.length; column++) {
      const own = Math.min(Math.abs(codes[column]), OWN_MAX) << SIZE_BITS;
      sizes[column] += own - (sizes[column] >>> FADING_BITS);
    }
    this.rank++;
    if (this.rank < 3 || this.rank % RENEWED_EVERY === 0) this.renew();
  }

  /** By falling size, then by key: sorted as one number of 32 + 14 bits. */
  renew() {
    const keys = Float64Array.from(this.sizes, (size, column) => (0xffff_ffff - size) * 0x10000 + column);
    keys.sort();
    this.columns = Uint32Array.from(keys, (key) => key % 0x10000);
  }
}
