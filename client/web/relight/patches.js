// Surface patches, their receivers resolved to slots: the columns of clusters; twin of proto/src/relight/patches.rs.

import { isDifference, levelOf, patchOf, skyPartOf } from "../chunk/patch_key.js";
import { areaTexels } from "../chunk/patches.js";
import { SKY_PARTS_MAX } from "../chunk/limits.js";
import { Inconsistent } from "./inconsistent.js";
import { relightDirection, skyRadiance } from "./sky.js";
import { DARK, NO_SLOT } from "./slots.js";

/** Leaves in a row that are summed once for all patches, and such sums that are summed again. */
export const LEAF_BLOCK = 64;
/** Level of columns that no level of detail leaves out. */
export const ALWAYS = 255;
/** Stands for the patch that a root is part of. */
export const NO_PATCH = 0xffffffff;

/**
 * The surface patches of a bake, and the parts of its sky. λ has the radiance of each patch, then for each its difference
 * from that of the patch which it is part of, then the sky's parts.
 */
export class PatchTable {
  #byKey = new Map();

  constructor(set, slots) {
    try {
      this.#resolve(set, slots);
    } catch (error) {
      throw new Inconsistent("patches", error.message);
    }
  }

  #resolve(set, slots) {
    if (set.skyParts > SKY_PARTS_MAX) {
      throw new Error(`has ${set.skyParts} parts of the sky`);
    }
    const blocks = slots.blockIndices(set.blocks);
    this.skyParts = set.skyParts;
    this.leafStarts = set.leafStarts;
    this.areas = Float32Array.from(set.area, areaTexels);
    this.slots = Uint32Array.from(set.block, (index, place) => {
      const block = blocks[index];
      if (block === undefined) {
        throw new Error(`names block ${index}`);
      }
      // The baker leaves out receivers that no light can reach.
      const slot = slots.standing(block, set.texel[2 * place], set.texel[2 * place + 1]);
      return slot === NO_SLOT ? DARK : slot;
    });
    this.count = set.patches.length;
    const parents = parentsOf(set);
    // Three numbers each, as shaders read them: first leaf, leaves, parent.
    this.patches = new Uint32Array(3 * this.count);
    const { key, firstLeaf, leafCount } = set.patches;
    for (let index = 0; index < this.count; index++) {
      this.#byKey.set(key[index], index);
      this.patches.set([firstLeaf[index], leafCount[index], parents[index]], 3 * index);
    }
  }

  /** Highest band: patches have one number each. */
  get bands() {
    return 0;
  }

  /** Numbers in λ. */
  get lambdaCount() {
    return 2 * this.count + this.skyParts;
  }

  get leafCount() {
    return Math.max(this.leafStarts.length - 1, 0);
  }

  /** Tree level of a column by its key: levels of detail leave out those below theirs; `ALWAYS` without which light is lost. */
  level(key) {
    return isDifference(key) ? levelOf(key) : ALWAYS;
  }

  /** Place of a column in λ by its key; −1 where there is none. */
  index(key) {
    const part = skyPartOf(key);
    if (part !== null) {
      return part < this.skyParts ? 2 * this.count + part : -1;
    }
    const patch = this.#byKey.get(patchOf(key));
    return patch === undefined ? -1 : patch + (isDifference(key) ? this.count : 0);
  }

  /** The end of λ: the sky's radiance in the middle of each part, four numbers each. */
  skyLambda(sky) {
    const lambda = new Float32Array(4 * this.skyParts);
    for (let part = 0; part < this.skyParts; part++) {
      lambda.set(skyRadiance(sky, relightDirection(part, this.skyParts)), 4 * part);
    }
    return lambda;
  }
}

/**
 * The patch that each is part of: the smallest other run of leaves that holds its own; of equal runs, that of the next
 * higher level.
 */
export function parentsOf({ patches }) {
  const { length, key, firstLeaf, leafCount } = patches;
  const ends = leafCount.map((count, patch) => firstLeaf[patch] + count);
  const levels = Uint8Array.from(key, levelOf);
  const order = Uint32Array.from({ length }, (_, index) => index);
  // Wholes come before their parts.
  order.sort((a, b) => firstLeaf[a] - firstLeaf[b] || ends[b] - ends[a] || levels[b] - levels[a] || a - b);
  const parents = new Uint32Array(length).fill(NO_PATCH);
  const wholes = [];
  for (const patch of order) {
    while (wholes.length > 0 && ends[wholes.at(-1)] < ends[patch]) {
      wholes.pop();
    }
    parents[patch] = wholes.at(-1) ?? NO_PATCH;
    wholes.push(patch);
  }
  return parents;
}
