// Radiance of receivers → mean radiance of surface patches, and its difference from that of the patch around each; twin of
// client/src/passes/patches.

import { LEAF_BLOCK } from "../relight/patches.js";
import { THREADS, dispatch, groupsFor } from "./gpu.js";
import { FOUR } from "./resident.js";

/** The pass: leaves, then blocks of them, then blocks of these, then patches, then differences. */
export class PatchesPass {
  static async create(gpu, table, resident) {
    const pass = new PatchesPass();
    const { leafCount } = table;
    const blocks = Math.ceil(leafCount / LEAF_BLOCK);
    const [firstBlock, firstLarge] = [leafCount, leafCount + blocks];
    const all = Math.max(firstLarge + Math.ceil(blocks / LEAF_BLOCK), 1);
    const numbers = (counts, source = [0, 0]) => {
      const stride = counts[0] * THREADS;
      const values = [resident.receiverCount, leafCount, table.count, stride, firstBlock, firstLarge, ...source];
      return gpu.uniform("patches", Uint32Array.from(values));
    };
    const leaves = gpu.blank("leaves", FOUR * all);
    const patches = gpu.storage("patches", table.patches);
    const step = async (entry, counts, uniform, resources) => {
      const pipeline = await gpu.compute("patches", entry);
      const group = gpu.bindAt(pipeline.getBindGroupLayout(0), [[0, uniform], ...resources]);
      return { pipeline, groups: [group], counts };
    };
    const ofLeaves = groupsFor(leafCount);
    const block = ([from, to]) => {
      const counts = groupsFor(Math.ceil((to - from) / LEAF_BLOCK));
      return step("sum_blocks", counts, numbers(counts, [from, to]), [[7, leaves]]);
    };
    const ofPatches = groupsFor(table.count);
    const uniform = numbers(ofPatches);
    const means = [[8, patches], [9, resident.lambda]];
    pass.steps = [
      await step("sum_leaves", ofLeaves, numbers(ofLeaves), [
        [1, gpu.storage("leaf starts", table.leafStarts)],
        [2, gpu.storage("slots", table.slots)],
        [3, resident.albedo],
        [4, resident.eDir],
        [5, resident.eEmit],
        [6, resident.eInd],
        [7, leaves],
        [10, gpu.storage("areas", table.areas)],
      ]),
      await block([0, firstBlock]),
      await block([firstBlock, firstLarge]),
      await step("mean_of_patches", ofPatches, uniform, [[7, leaves], ...means]),
      await step("difference_of_patches", ofPatches, uniform, means),
    ];
    return pass;
  }

  record(pass) {
    this.steps.forEach((step) => dispatch(pass, step));
  }
}
