// Detail of each cluster for an eye: which columns, ranks and receivers bounces compute, and how often; twin of
// proto/src/relight/lod/plan.rs.

import { LOD_LEVELS, NOWHERE_M, closestM, distancesM } from "./lod.js";
import { fround } from "./numbers.js";
import { GROUP } from "./packed.js";

/** Words of a cluster's detail as shaders read it. */
export const DETAIL_WORDS = 9;
// Places of some of them.
const [ROWS, WIDE, BYTES, REST, GROUPS, INTERVAL] = [2, 3, 4, 5, 6, 8];

/** All of a cluster, in each bounce: first row, rows, rows that are computed, columns by class, groups of ranks, level, interval. */
export function fullDetail({ firstRow, rowCount, columnCount, rank, vt: { wide, bytes } }) {
  return [firstRow, rowCount, rowCount, wide, bytes, columnCount - wide - bytes, Math.ceil(rank / GROUP), 0, 1];
}

/** Detail of all clusters, `{columnLevels, clusters}`, of a table of theirs for an eye, `{positionM, forward, viewCos, diagonalM}`. */
export class LodPlan {
  /** A cluster that was planned `before` keeps its level unless it is past the distance by a margin. */
  constructor(table, all, lod, eye, before = null) {
    Object.assign(this, { lod, eye });
    const { clusters } = all;
    const old = before?.lod === lod && before.levels.length === clusters.length ? before : null;
    const begins = distancesM(lod, eye.diagonalM);
    /** Level of each cluster. */
    this.levels = new Uint8Array(clusters.length);
    /** Detail of each as shaders read it. */
    this.details = new Uint32Array(DETAIL_WORDS * clusters.length);
    clusters.forEach((cluster, index) => {
      const distance = closestM(table.boundsM.subarray(6 * index, 6 * index + 6), lod, eye);
      const wanted = levelAt(begins, distance, 0);
      const own = old?.levels[index] ?? wanted;
      const level = wanted > own ? Math.max(own, levelAt(begins, distance, lod.margin)) : wanted;
      this.levels[index] = level;
      this.details.set(detailOf(table, all, index, lod.levels[level]), DETAIL_WORDS * index);
    });
    /** Numbers for the blend at receivers, as shaders read them. */
    this.view = viewOf(lod, eye, begins);
  }

  /** Bounces in which each cluster takes part once at least. */
  get cycle() {
    let most = 1;
    for (let at = INTERVAL; at < this.details.length; at += DETAIL_WORDS) most = Math.max(most, this.details[at]);
    return most;
  }

  /** Work by level: clusters, their receivers and those that are computed, numbers of their ΣVᵀ and those that are read. */
  counts({ clusters }) {
    const counts = this.lod.levels.map(({ interval }) => {
      return { clusters: 0, receivers: 0, receiversComputed: 0, numbers: 0, numbersRead: 0, interval };
    });
    clusters.forEach(({ rowCount, columnCount, rank }, index) => {
      const detail = this.details.subarray(DETAIL_WORDS * index, DETAIL_WORDS * (index + 1));
      const count = counts[this.levels[index]];
      count.clusters += 1;
      count.receivers += rowCount;
      count.receiversComputed += detail[ROWS];
      count.numbers += columnCount * rank;
      count.numbersRead += (detail[WIDE] + detail[BYTES] + detail[REST]) * Math.min(rank, GROUP * detail[GROUPS]);
    });
    return counts;
  }
}

/** The last level that begins no farther than a distance, by a margin. */
function levelAt(begins, distance, margin) {
  for (let level = LOD_LEVELS - 1; level > 0; level--) {
    if (distance >= fround(begins[level] * fround(1 + margin))) return level;
  }
  return 0;
}

function detailOf({ rows }, { clusters, columnLevels }, index, settings) {
  const [firstRow, rowCount, , wide, bytes, rest, groups] = fullDetail(clusters[index]);
  const first = clusters[index].firstColumn;
  // Levels fall within each class of columns.
  const counted = (from, count) => {
    let [kept, end] = [0, count];
    while (kept < end) {
      const half = (kept + end) >>> 1;
      if (columnLevels[first + from + half] >= settings.columns) kept = half + 1;
      else end = half;
    }
    return kept;
  };
  const columns = [counted(0, wide), counted(wide, bytes), counted(wide + bytes, rest)];
  const computed = rows[LOD_LEVELS * index + settings.receivers];
  const ranks = Math.min(groups, Math.ceil(settings.rank / GROUP));
  return [firstRow, rowCount, computed, ...columns, ranks, settings.receivers, settings.interval];
}

function viewOf({ levels, beside, behind, blend }, { positionM, forward, viewCos }, begins) {
  // Receivers of a level are left out from the first level of detail on that has none of them.
  const ends = [0, 1, 2].map((level) => {
    const first = levels.findIndex(({ receivers }) => receivers > level);
    return first < 0 ? NOWHERE_M : begins[first];
  });
  const starts = ends.map((end) => fround(end * fround(1 - blend)));
  return Float32Array.from([...positionM, viewCos, ...forward, beside, ...starts, behind, ...ends, 0]);
}
