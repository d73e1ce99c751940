// Irradiance from lights at receivers: the mean over the points of their texels; twin of client/src/passes/direct/texels.rs.

import { COMPUTE, THREADS, dispatch, groupsFor } from "./gpu.js";

const KINDS = ["uniform", "read-only-storage", "read-only-storage", "storage", "read-only-storage", "read-only-storage"];

export class DirectPass {
  /** Uploads the points of all texels. */
  static async create(gpu, { starts, points, reachM }, shadow, resident) {
    const pass = new DirectPass();
    const layout = gpu.bindLayout(KINDS.map((type) => ({ visibility: COMPUTE, buffer: { type } })));
    const both = gpu.pipelineLayout([shadow.lightLayout, layout]);
    const pipeline = await gpu.compute("direct-texels", "direct_texels", both);
    // A receiver without points takes room in the table of starts alone.
    const bytes = Array.from({ length: starts.length - 1 }, (_, slot) => {
      return Math.max(8 * (starts[slot + 1] - starts[slot]), 8);
    });
    pass.pages = gpu.pages("receiver's points", bytes).map(([from, to]) => {
      const own = starts.slice(from, to + 1).map((start) => start - starts[from]);
      const counts = groupsFor(to - from);
      const numbers = new Uint32Array([from, to - from, counts[0] * THREADS, 0]);
      new Float32Array(numbers.buffer)[3] = reachM;
      const group = gpu.bind(layout, [
        gpu.uniform("texels", numbers),
        resident.positions,
        resident.normals,
        resident.eDir,
        gpu.storage("first points of texels", own),
        gpu.storage("points of texels", points.subarray(2 * starts[from], 2 * starts[to])),
      ]);
      // The group of lights is another one where objects bring the first glass.
      return { pipeline, get groups() { return [shadow.lightGroup, group]; }, counts };
    });
    return pass;
  }

  record(pass) {
    this.pages.forEach((page) => dispatch(pass, page));
  }
}
