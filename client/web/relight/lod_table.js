// Facts of a bake that levels of detail need, whatever the eye: bounds, the order of rows, stand-ins; twin of
// proto/src/relight/lod/table.rs.

import { Growing } from "./growing.js";
import { LOD_LEVELS } from "./lod.js";
import { NO_SLOT } from "./slots.js";

/** Words of a receiver with stand-ins, as shaders read them: its slot, its cluster, four slots. */
export const STAND_IN_WORDS = 6;
/** No receiver. */
export const NO_STAND_IN = 0xffffffff;
// Offset of the texel that each bit of a receiver's links speaks of, lowest bit first.
const LINKS = [[1, 0], [0, 1], [1, 1], [-1, 1]];
const AROUND = [[-1, -1], [1, -1], [-1, 1], [1, 1]];
const BESIDE = [[-1, 0], [1, 0]];
const BELOW = [[0, -1], [0, 1]];

/** Bounds of clusters, orders of their rows, and stand-ins. */
export class LodTable {
  constructor(slots, receivers, { clusters }) {
    const clusterOf = new Uint32Array(receivers.count);
    clusters.forEach(({ firstRow, rowCount }, index) => clusterOf.fill(index, firstRow, firstRow + rowCount));
    // Rows without stand-ins are of all levels.
    const levels = new Uint8Array(receivers.count).fill(LOD_LEVELS - 1);
    const standIns = Array.from({ length: LOD_LEVELS - 1 }, () => new Growing(Uint32Array));
    slots.forEachReceiver((slot, block, x, y) => {
      const level = levelOf(x, y);
      if (level + 1 === LOD_LEVELS) return;
      const sources = standInsOf(slots, receivers, block, x, y, level);
      if (sources[0] === NO_STAND_IN) return;
      levels[slot] = level;
      standIns[level].extend([slot, clusterOf[slot], ...sources]);
    });
    /** Receivers with stand-ins by level, the finest first, `STAND_IN_WORDS` each. */
    this.standIns = standIns.map((words) => words.finish());
    /** Rows of each cluster by slot, those first that all levels compute; each counts from its cluster's first. */
    this.order = new Uint32Array(receivers.count);
    /** Rows of each cluster that are computed at each level of receivers. */
    this.rows = new Uint32Array(LOD_LEVELS * clusters.length);
    /** Bounds of each cluster's receivers in metres: low, then high. */
    this.boundsM = new Float32Array(6 * clusters.length);
    clusters.forEach((cluster, index) => this.#push(cluster, index, levels, receivers));
  }

  #push({ firstRow, rowCount }, index, levels, { positionM }) {
    let at = firstRow;
    for (let level = LOD_LEVELS - 1; level >= 0; level--) {
      for (let row = 0; row < rowCount; row++) {
        if (levels[firstRow + row] === level) this.order[at++] = row;
      }
      this.rows[LOD_LEVELS * index + level] = at - firstRow;
    }
    const bounds = this.boundsM.subarray(6 * index, 6 * index + 6).fill(Infinity, 0, 3).fill(-Infinity, 3, 6);
    for (let slot = firstRow; slot < firstRow + rowCount; slot++) {
      for (let axis = 0; axis < 3; axis++) {
        const place = positionM[4 * slot + axis];
        bounds[axis] = Math.min(bounds[axis], place);
        bounds[3 + axis] = Math.max(bounds[3 + axis], place);
      }
    }
  }
}

/** Trailing zero bits common to both coordinates, as chunks count them. */
function levelOf(x, y) {
  const both = x | y;
  return both === 0 ? LOD_LEVELS - 1 : Math.min(31 - Math.clz32(both & -both), LOD_LEVELS - 1);
}

/**
 * Receivers of higher levels in whose middle a texel of a level is: two along an axis, or four around. Those that a wall parts from it,
 * or a texel without receiver, are left out.
 */
function standInsOf(slots, receivers, block, x, y, level) {
  const [isOddX, isOddY] = [x, y].map((along) => ((along >>> level) & 1) === 1);
  const ways = isOddX ? (isOddY ? AROUND : BESIDE) : BELOW;
  const found = [];
  for (const [dx, dy] of ways) {
    const slot = walked(slots, receivers, block, x, y, dx, dy, 1 << level);
    if (slot !== NO_SLOT) found.push(slot);
  }
  while (found.length < 4) found.push(NO_STAND_IN);
  return found;
}

/** Slot of the receiver so many steps away from that of a texel, if no wall parts any two on the way; else NO_SLOT. */
function walked(slots, receivers, block, x, y, dx, dy, steps) {
  let slot = NO_SLOT;
  for (let step = 0; step < steps; step++) {
    slot = linked(slots, receivers, block, x + dx * step, y + dy * step, dx, dy);
    if (slot === NO_SLOT) break;
  }
  return slot;
}

/** Slot of the neighbour at an offset of one texel at most along each axis, if no wall parts the two; else NO_SLOT. */
function linked(slots, { links }, block, x, y, dx, dy) {
  const own = slots.slot(block, x, y);
  const other = slots.slot(block, x + dx, y + dy);
  if (own === NO_SLOT || other === NO_SLOT) return NO_SLOT;
  const bitOf = (alongX, alongY) => LINKS.findIndex(([linkX, linkY]) => linkX === alongX && linkY === alongY);
  const there = bitOf(dx, dy);
  const isLinked = there >= 0 ? (links[own] >>> there) & 1 : (links[other] >>> bitOf(-dx, -dy)) & 1;
  return isLinked ? other : NO_SLOT;
}
