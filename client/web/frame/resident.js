// Arrays of receivers and clusters on the device that several passes share; twin of client/src/passes/resident.rs.

import { fullDetail } from "../relight/lod_plan.js";
import { groups2d } from "./gpu.js";

/** Bytes of a vector of four numbers. */
export const FOUR = 16;

/** Receivers, and the arrays that passes hand to each other. */
export class Resident {
  constructor(gpu, { receivers, clusters, columns }) {
    const bySlot = FOUR * receivers.count;
    this.receiverCount = receivers.count;
    this.lambdaCount = columns.lambdaCount;
    this.positions = gpu.storage("positions", receivers.positionM);
    this.normals = gpu.storage("normals", receivers.normal);
    this.albedo = gpu.storage("albedo", receivers.albedo);
    this.eDir = gpu.blank("E_dir", bySlot);
    this.eEmit = gpu.blank("E_emit", bySlot);
    this.eInd = gpu.blank("E_ind", bySlot);
    this.eNear = gpu.blank("E of near hits", bySlot);
    this.lambda = gpu.blank("lambda", FOUR * columns.lambdaCount);
    this.b = gpu.blank("b", FOUR * clusters.bLen);
    // All of each cluster, in each bounce, until there are levels of detail.
    this.fullDetails = Uint32Array.from(clusters.clusters.flatMap(fullDetail));
    this.details = gpu.storage("details", this.fullDetails);
    this.order = gpu.blank("order of rows", 4 * receivers.count);
    this.clusterCount = clusters.clusters.length;
    this.turn = gpu.uniform("turn", turnOf(this.clusterCount, 0));
  }

  /** Writes the end of λ, which no pass writes. */
  writeSky(gpu, sky) {
    gpu.write(this.lambda, sky, FOUR * this.lambdaCount - sky.byteLength);
  }
}

/** Number of a bounce, of clusters, and of those in a row of a dispatch over all, as shaders read them. */
export function turnOf(clusterCount, bounce) {
  return Uint32Array.from([bounce, clusterCount, groups2d(clusterCount)[0]]);
}

/** Rows of some clusters as shaders read them, for one of their factors, `u` or `vt`, in a page whose first word is `first`. */
export function clusterRows(clusters, factor, first) {
  const rows = clusters.flatMap((cluster) => {
    const { firstRow, rowCount, firstColumn, columnCount, rank, firstB } = cluster;
    const { first: firstWord, wide, wideWords, bytes } = cluster[factor];
    return [firstRow, rowCount, firstColumn, columnCount, rank, firstB, firstWord - first, wide, wideWords, bytes];
  });
  return Uint32Array.from(rows);
}

/** The words of a factor of some clusters, which lie one after the other: first and end. */
export function wordsOf(clusters, factor) {
  const last = clusters.at(-1)[factor];
  return [clusters[0][factor].first, last.first + last.len];
}
