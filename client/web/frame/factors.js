// λ → cluster coefficients, and these → irradiance at receivers; twin of client/src/passes/basis and
// client/src/passes/reconstruct. One dispatch per page of ΣVᵀ and of U.

import { THREADS, dispatch, groups2d } from "./gpu.js";
import { clusterRows, wordsOf } from "./resident.js";

// Rows of a workgroup of the shader that reconstructs.
const ROWS = 4 * THREADS;
// Threads of a group of `basis` on adapters that are processors in truth.
const PROCESSOR_THREADS = 64;

/** b_c = s (ΣVᵀ) λ|_c. */
export class BasisPass {
  static async create(gpu, table, resident) {
    const pass = new BasisPass();
    const constants = gpu.isProcessor() ? { THREADS: PROCESSOR_THREADS } : {};
    const pipeline = await gpu.compute("basis", "project", "auto", constants);
    const columns = gpu.storage("columns", table.columns);
    const steps = gpu.storage("steps", table.steps);
    pass.pages = pagesOf(gpu, table, "vt").map(({ firstCluster, clusters, rows, words }) => {
      const counts = groups2d(clusters.length);
      const group = gpu.bind(pipeline.getBindGroupLayout(0), [
        gpu.uniform("basis", Uint32Array.from([counts[0], clusters.length, firstCluster])),
        rows,
        columns,
        words,
        steps,
        resident.lambda,
        resident.b,
        resident.details,
        resident.turn,
      ]);
      return { pipeline, groups: [group], counts };
    });
    return pass;
  }

  record(pass) {
    this.pages.forEach((page) => dispatch(pass, page));
  }
}

/** E_r = max(N_r + U_r · b_c, −F_r), where N is of near hits and F is E_emit. */
export class ReconstructPass {
  static async create(gpu, table, resident) {
    const pass = new ReconstructPass();
    const pipeline = await gpu.compute("reconstruct", "expand");
    pass.pages = pagesOf(gpu, table, "u").map(({ firstCluster, clusters, rows, words }) => {
      const most = clusters.reduce((sum, { rowCount }) => Math.max(sum, rowCount), 0);
      const [stride, layers] = groups2d(clusters.length);
      const group = gpu.bind(pipeline.getBindGroupLayout(0), [
        gpu.uniform("reconstruct", Uint32Array.from([stride, clusters.length, 1, firstCluster])),
        rows,
        words,
        resident.b,
        resident.eNear,
        resident.eEmit,
        resident.eInd,
        resident.details,
        resident.order,
        resident.turn,
      ]);
      return { pipeline, groups: [group], counts: [Math.ceil(most / ROWS), stride, layers] };
    });
    return pass;
  }

  record(pass) {
    this.pages.forEach((page) => dispatch(pass, page));
  }
}

/** Clusters by pages of one of their factors, with the rows and words of each page in buffers. */
function pagesOf(gpu, table, factor) {
  const bytes = table.clusters.map((cluster) => 4 * cluster[factor].len);
  return gpu.pages(`cluster's ${factor}`, bytes).map(([from, to]) => {
    const clusters = table.clusters.slice(from, to);
    const [first, end] = wordsOf(clusters, factor);
    return {
      firstCluster: from,
      clusters,
      rows: gpu.storage("clusters", clusterRows(clusters, factor, first)),
      words: gpu.storage(factor, table[factor].subarray(first, end)),
    };
  });
}
