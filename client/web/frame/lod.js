// Level of detail on the device: which part of each cluster bounces compute, and light of the receivers that are left out; twin of
// client/src/passes/lod.

import { LOD_LEVELS } from "../relight/lod.js";
import { STAND_IN_WORDS } from "../relight/lod_table.js";
import { THREADS, dispatch, groups2d, groupsFor } from "./gpu.js";
import { turnOf } from "./resident.js";

// Bytes of the numbers for the blend at receivers.
const VIEW_BYTES = 64;

export class LodPass {
  // Details as the device has them.
  #written;
  #isOn = false;

  /** Uploads orders of rows and stand-ins. Frees all of it where that fails. */
  static async create(whole, table, resident) {
    const pass = new LodPass();
    [pass.gpu, pass.resident] = [whole.branch(), resident];
    try {
      await pass.#make(table);
    } catch (error) {
      pass.destroy();
      throw error;
    }
    return pass;
  }

  async #make(table) {
    const { gpu, resident } = this;
    const { turn, details, order, eNear, positions, eEmit, eInd } = resident;
    this.#written = resident.fullDetails;
    gpu.write(order, table.order);
    const [mark, fill] = await Promise.all([gpu.compute("lod-mark", "mark"), gpu.compute("lod-fill", "fill")]);
    const marked = gpu.bind(mark.getBindGroupLayout(0), [turn, details, order, eNear]);
    this.marking = { pipeline: mark, groups: [marked], counts: groups2d(resident.clusterCount) };
    this.view = gpu.buffer("eye", VIEW_BYTES, GPUBufferUsage.UNIFORM);
    // Coarsest first.
    this.fills = [];
    for (let level = LOD_LEVELS - 2; level >= 0; level--) {
      const words = table.standIns[level];
      const bytes = new Array(words.length / STAND_IN_WORDS).fill(4 * STAND_IN_WORDS);
      for (const [from, to] of gpu.pages("receiver's stand-ins", bytes)) {
        const counts = groupsFor(to - from);
        const numbers = gpu.uniform("stand-ins", Uint32Array.from([to - from, counts[0] * THREADS, level]));
        const standIns = gpu.storage("stand-ins", words.subarray(STAND_IN_WORDS * from, STAND_IN_WORDS * to));
        const bound = [numbers, turn, this.view, details, standIns, positions, eEmit, eInd];
        this.fills.push({ pipeline: fill, groups: [gpu.bind(fill.getBindGroupLayout(0), bound)], counts });
      }
    }
  }

  /** Frees all buffers. */
  destroy() {
    this.gpu.destroy();
  }

  /** Writes a plan (`LodPlan`), or with null all of each cluster. */
  set(plan) {
    const { gpu, resident } = this;
    this.#isOn = plan !== null;
    const details = plan?.details ?? resident.fullDetails;
    // An eye that moves changes the level of few clusters, and in most frames of none.
    if (details.some((word, at) => word !== this.#written[at])) {
      gpu.write(resident.details, details);
      this.#written = details;
    }
    if (plan !== null) gpu.write(this.view, plan.view);
  }

  /** Writes the number of the next bounce. */
  setTurn(bounce) {
    this.gpu.write(this.resident.turn, turnOf(this.resident.clusterCount, bounce));
  }

  /** Records the marks of receivers that are not computed, before near hits are gathered. */
  mark(pass) {
    dispatch(pass, this.marking);
  }

  /** Records the stand-ins, after receivers are computed. */
  fill(pass) {
    if (this.#isOn) this.fills.forEach((fill) => dispatch(pass, fill));
  }
}
