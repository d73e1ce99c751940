// Irradiance that receivers in narrow places get from their near hits; twin of client/src/passes/near.

import { COMPUTE, THREADS, dispatch, groupsFor } from "./gpu.js";
import { FOUR } from "./resident.js";

const READ = { visibility: COMPUTE, buffer: { type: "read-only-storage" } };
const WRITTEN = { visibility: COMPUTE, buffer: { type: "storage" } };
const UNIFORM = { visibility: COMPUTE, buffer: { type: "uniform" } };

export class NearPass {
  /** Uploads the hits. */
  static async create(gpu, table, shadow, resident) {
    const pass = new NearPass();
    const layout = gpu.bindLayout([UNIFORM, READ, READ, READ, READ, READ, WRITTEN]);
    const both = gpu.pipelineLayout([shadow.lightLayout, layout]);
    const light = await gpu.compute("near-lit", "light_hits", both);
    const gather = await gpu.compute("near", "gather");
    const own = gpu.storage("surfaces of near hits", table.own);
    const { normals, albedo, eEmit, eInd, eNear } = resident;
    pass.pages = pagesOf(gpu, table).map(({ rows, hits }) => {
      const count = rows.length / 4;
      const counts = groupsFor(count);
      const numbers = gpu.uniform("near", Uint32Array.from([count, counts[0] * THREADS]));
      const lit = gpu.blank("light of near hits", FOUR * count);
      const shared = [numbers, gpu.storage("near rows", rows), gpu.storage("near hits", hits), own];
      const lightGroup = gpu.bind(layout, [...shared, normals, albedo, lit]);
      const bound = [...shared, albedo, lit, eEmit, eInd, eNear];
      return {
        // The group of lights is another one where objects bring the first glass.
        light: { pipeline: light, get groups() { return [shadow.lightGroup, lightGroup]; }, counts },
        gather: { pipeline: gather, groups: [gpu.bind(gather.getBindGroupLayout(0), bound)], counts },
      };
    });
    return pass;
  }

  /** Records light that comes straight from lights. */
  light(pass) {
    this.pages.forEach((page) => dispatch(pass, page.light));
  }

  /** Records the sums over hits; E_ind is still that of the bounce before. */
  record(pass) {
    this.pages.forEach((page) => dispatch(pass, page.gather));
  }
}

/** Rows and hits by pages, rows counting from the page's first hit. */
function pagesOf(gpu, { rows, hits }) {
  // Rows and sums have as many bytes as hits, of which each has one at least.
  const bytes = Array.from({ length: rows.length / 4 }, (_, row) => 16 * rows[4 * row + 2]);
  return gpu.pages("receiver's near hits", bytes).map(([from, to]) => {
    const own = rows.slice(4 * from, 4 * to);
    const start = own[1];
    const end = own.at(-3) + own.at(-2);
    for (let row = 0; row < own.length; row += 4) {
      own[row + 1] -= start;
    }
    return { rows: own, hits: hits.subarray(4 * start, 4 * end) };
  });
}
