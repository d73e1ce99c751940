// Receivers that stand for those which are not there, while a bake's clusters come; twin of proto/src/relight/stand_ins.rs.

import { levelOf } from "../chunk/patch_key.js";
import { Inconsistent } from "./inconsistent.js";
import { NO_PATCH, parentsOf } from "./patches.js";
import { NO_SLOT } from "./slots.js";

// Level of the patches in which receivers stand for each other.
const STAND_IN_LEVEL = 3;
// Texels of one patch of this level are of one side of a wall.
const SIDE_LEVEL = 4;
// Of more receivers than this those around a place in stored order alone are asked for the nearest.
const ASKED_MAX = 256;

/**
 * Makes the nearest receiver of its coarse patch stand for each receiver of the set that has no slot. Where a coarse patch
 * has none, its texels stay dark.
 */
export function standIn(set, slots) {
  let blocks;
  try {
    blocks = slots.blockIndices(set.blocks);
  } catch (error) {
    throw new Inconsistent("patches", error.message);
  }
  if (set.block.some((block) => blocks[block] === undefined)) {
    throw new Inconsistent("patches", "name a block that they do not list");
  }
  const named = (place) => [blocks[set.block[place]], set.texel[2 * place], set.texel[2 * place + 1]];
  const parents = parentsOf(set);
  coarseOfLeaves(set, parents, SIDE_LEVEL).forEach((side, leaf) => {
    for (let place = set.leafStarts[leaf]; place < set.leafStarts[leaf + 1]; place++) {
      slots.setSide(...named(place), side);
    }
  });
  for (const [start, end] of runsOf(set, coarseOfLeaves(set, parents, STAND_IN_LEVEL))) {
    const standing = [];
    for (let place = start; place < end; place++) {
      if (slots.slot(...named(place)) !== NO_SLOT) {
        standing.push(place);
      }
    }
    if (standing.length === 0 || standing.length === end - start) {
      continue;
    }
    for (let place = start; place < end; place++) {
      const nearest = nearestOf(set, place, standing);
      const slot = nearest === place ? NO_SLOT : slots.slot(...named(nearest));
      if (slot !== NO_SLOT) {
        slots.standIn(...named(place), slot);
      }
    }
  }
}

/** The smallest patch of `level` or above that each leaf lies in, or one below it that is part of none of that level. */
function coarseOfLeaves({ patches, leafStarts }, parents, level) {
  const whole = new Uint32Array(patches.length).fill(NO_PATCH);
  for (let first = 0; first < patches.length; first++) {
    const path = [];
    let patch = first;
    while (whole[patch] === NO_PATCH) {
      path.push(patch);
      const parent = parents[patch];
      if (parent !== NO_PATCH && levelOf(patches.key[parent]) <= level) {
        patch = parent;
      } else {
        whole[patch] = patch;
      }
    }
    for (const passed of path) {
      whole[passed] = whole[patch];
    }
  }
  const order = Uint32Array.from({ length: patches.length }, (_, index) => index).filter((index) => whole[index] === index);
  // Parts overwrite their wholes.
  order.sort((a, b) => {
    const bySize = patches.leafCount[b] - patches.leafCount[a];
    return bySize || levelOf(patches.key[b]) - levelOf(patches.key[a]) || a - b;
  });
  const ofLeaf = new Uint32Array(Math.max(leafStarts.length - 1, 0)).fill(NO_PATCH);
  for (const index of order) {
    const first = patches.firstLeaf[index];
    ofLeaf.fill(index, first, first + patches.leafCount[index]);
  }
  return ofLeaf;
}

/** Runs of receivers in one coarse patch, as ranges of the set's arrays. */
function runsOf({ leafStarts }, ofLeaf) {
  const runs = [];
  ofLeaf.forEach((patch, leaf) => {
    if (leaf > 0 && ofLeaf[leaf - 1] === patch) {
      runs.at(-1)[1] = leafStarts[leaf + 1];
    } else {
      runs.push([leafStarts[leaf], leafStarts[leaf + 1]]);
    }
  });
  return runs;
}

/** The nearest of `standing`, ascending places in the set's arrays, to the receiver at a place. */
function nearestOf(set, place, standing) {
  let around = 0;
  for (let size = standing.length; size > 0; ) {
    const half = size >>> 1;
    if (standing[around + half] < place) {
      around += half + 1;
      size -= half + 1;
    } else {
      size = half;
    }
  }
  const last = Math.max(standing.length - ASKED_MAX, 0);
  const first = Math.min(Math.max(around - ASKED_MAX / 2, 0), last);
  let best = -1;
  let least = Infinity;
  for (const other of standing.slice(first, first + ASKED_MAX)) {
    const away = distance(set, place, other);
    if (away < least) {
      [best, least] = [other, away];
    }
  }
  return best;
}

/** Squared distance of two receivers of a set in texels; those of another block are farther than all of one. */
function distance({ block, texel }, a, b) {
  const dx = texel[2 * a] - texel[2 * b];
  const dy = texel[2 * a + 1] - texel[2 * b + 1];
  return (block[a] === block[b] ? 0 : 2 ** 40) + dx * dx + dy * dy;
}
