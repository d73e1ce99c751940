// How factors are cut into sections, and which prefixes of them are a cluster's coarser versions.

import { inRange } from "./error.js";
import { BANDS_MAX, CLUSTER_KEYS_MAX, LEVELS_MAX, RANK_MAX, RECEIVERS_MAX, VT_ENTRIES_MAX } from "./limits.js";

/** Ends of the groups of ranks. */
export const RANK_GROUP_ENDS = [8, 16, 32, 64];
/** Last bands of the groups of bands. */
export const BAND_GROUP_LASTS = [2, 4, 7, 10];

/**
 * Counts that decide the grid of sections of some rows' factors: `counts` by level, finest first, `levels` in use, `keys`, `sky`,
 * `bands`, `rank`. A layer is `{level, bands, rank}`.
 */
export class FactorShape {
  constructor(counts, { levels, keys, sky, bands, rank }) {
    Object.assign(this, { counts, levels, keys, sky, bands, rank });
  }

  /** Throws if a count passes its limit. */
  check(section) {
    inRange(section, "levels", this.levels, 1, LEVELS_MAX);
    inRange(section, "bands", this.bands, 0, BANDS_MAX);
    inRange(section, "rank", this.rank, 0, RANK_MAX);
    inRange(section, "rows", this.receiversIn(0), 0, RECEIVERS_MAX);
    inRange(section, "rows of levels not in use", this.receiversIn(this.levels), 0, 0);
    inRange(section, "column keys", this.keys, 0, CLUSTER_KEYS_MAX);
    inRange(section, "entries of ΣVᵀ", this.rank * this.columns(this.bands), 0, VT_ENTRIES_MAX);
  }

  /** Everything. */
  full() {
    return { level: 0, bands: this.bands, rank: this.rank };
  }

  /** Receivers of `level` and coarser. */
  receiversIn(level) {
    return this.counts.slice(level).reduce((sum, count) => sum + count, 0);
  }

  /** Where receivers of `level` begin in stored order, and where they end. */
  rowsOf(level) {
    const first = this.receiversIn(level + 1);
    return [first, first + this.counts[level]];
  }

  /** Levels inside `layer` that have receivers, coarsest first. */
  levelsIn(layer) {
    const levels = [];
    for (let level = this.levels - 1; level >= layer.level; level--) if (this.counts[level] > 0) levels.push(level);
    return levels;
  }

  /** Levels that `layer` adds to `before`, coarsest first. */
  newLevels(before, layer) {
    const known = before === null ? this.levels : before.level;
    return this.levelsIn(layer).filter((level) => level < known);
  }

  /** Groups of columns: keys, and the sky. */
  columnGroups() {
    return this.keys + (this.sky ? 1 : 0);
  }

  /** Columns of ΣVᵀ with bands up to `bands`. */
  columns(bands) {
    return this.columnGroups() * (bands + 1) * (bands + 1);
  }

  /** Whether columns have scales: where each key has one column. */
  hasScales() {
    return this.bands === 0 && !this.sky;
  }
}

/** First rank of a rank group below `rank`, and the end. */
export function ranksOf(group, rank) {
  const first = group === 0 ? 0 : RANK_GROUP_ENDS[group - 1];
  return [Math.min(first, rank), Math.min(RANK_GROUP_ENDS[group], rank)];
}

/** First coefficient of a band group of bands up to `bands`, and the end. */
export function coefficientsOf(group, bands) {
  const first = Math.min(group === 0 ? 0 : BAND_GROUP_LASTS[group - 1] + 1, bands + 1);
  const end = Math.min(BAND_GROUP_LASTS[group], bands) + 1;
  return [first * first, end * end];
}

/** Number of rank groups that have any of the ranks below `rank`. */
export function rankGroups(rank) {
  return RANK_GROUP_ENDS.filter((end) => end < rank).length + (rank > 0 ? 1 : 0);
}

/** Number of band groups that have any of the bands up to `bands`. */
export function bandGroups(bands) {
  return BAND_GROUP_LASTS.filter((last) => last < bands).length + 1;
}
