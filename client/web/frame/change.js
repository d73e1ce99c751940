// The change of E_ind from one bounce to the next, which tells when bounces have converged. It is found on the device and read
// without a wait; twin of client/src/passes/change.

import { THREADS, dispatch } from "./gpu.js";
import { FOUR } from "./resident.js";

// Most workgroups of the first step.
const GROUPS_MAX = 512;
// Answers that may be under way at once.
const LANDINGS = 3;
// Bytes of an answer: two sums.
const ANSWER_BYTES = 8;

export class ChangePass {
  #free = [];
  #underWay = new Set();
  // Calls so far, and the last one that compared: E_ind as of then is kept.
  #calls = 0;
  #compared = 0;

  /** Binds E_ind; the first call compares it with black. */
  static async create(gpu, { eInd, receiverCount }) {
    const pass = new ChangePass();
    const groups = Math.min(Math.max(Math.ceil(receiverCount / THREADS), 1), GROUPS_MAX);
    const numbers = gpu.uniform("change", Uint32Array.from([receiverCount, groups * THREADS]));
    const before = gpu.blank("E_ind before", FOUR * receiverCount);
    // As long as it is bound: the second step goes through all of it.
    const sums = gpu.blank("sums of groups", ANSWER_BYTES * groups);
    pass.gpu = gpu;
    pass.result = gpu.blank("sums", ANSWER_BYTES);
    const step = async (entry, count, resources) => {
      const pipeline = await gpu.compute("change", entry);
      const group = gpu.bindAt(pipeline.getBindGroupLayout(0), resources);
      return { pipeline, groups: [group], counts: [count, 1] };
    };
    pass.steps = [
      await step("sum_of_groups", groups, [[0, numbers], [1, eInd], [2, before], [3, sums]]),
      await step("sum_of_all", 1, [[3, sums], [4, pass.result]]),
    ];
    for (let landing = 0; landing < LANDINGS; landing++) {
      pass.#free.push(gpu.buffer("change read back", ANSWER_BYTES, GPUBufferUsage.MAP_READ));
    }
    return pass;
  }

  /**
   * Runs the pass, and calls `heard` with `{call, since, change}` when it is known: the number of this call, from 1, that of the call
   * that it is compared with, 0 for black, and the relative change since then, 0 when both are black, no finite number where light is
   * none. Where too many answers are under way it does not run: the next answer spans this call too. Answers the call's number.
   */
  ask(heard) {
    this.#calls += 1;
    const [call, since, landing] = [this.#calls, this.#compared, this.#free.pop()];
    if (!landing) {
      return call;
    }
    this.#compared = call;
    this.gpu.submit((encoder) => {
      const pass = encoder.beginComputePass();
      this.steps.forEach((step) => dispatch(pass, step));
      pass.end();
      encoder.copyBufferToBuffer(this.result, 0, landing, 0, ANSWER_BYTES);
    });
    const told = (change) => heard({ call, since, change });
    const answer = this.#answer(landing, told).finally(() => this.#underWay.delete(answer));
    this.#underWay.add(answer);
    // Callers of `idle` hear of a lost device; others need not.
    answer.catch(() => {});
    return call;
  }

  /** Waits for all answers that are under way. */
  async idle() {
    await Promise.all(this.#underWay);
  }

  async #answer(landing, heard) {
    await landing.mapAsync(GPUMapMode.READ);
    const [difference, total] = new Float32Array(landing.getMappedRange(0, ANSWER_BYTES));
    landing.unmap();
    this.#free.push(landing);
    heard(difference === 0 && total === 0 ? 0 : difference / total);
  }
}
