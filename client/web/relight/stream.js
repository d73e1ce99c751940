// A bake that is fetched piece by piece: its scene and the light of the overview first, then clusters.

import { decodeCluster } from "../chunk/cluster.js";
import { decodeGeometry } from "../chunk/geometry.js";
import { ROLES, checkRelightable, chunksOf } from "../chunk/manifest.js";
import { decodePatches } from "../chunk/patches.js";
import { decodeTexture } from "../chunk/texture.js";
import { fetchChunk, fetchChunks, fetchManifest, forEachParallel, PARALLEL } from "../fetch.js";
import { assembleScene } from "./bake.js";
import { byNeed } from "./need.js";
import { lightOfPrefix } from "./prefix.js";

// Without known light, clusters come in the manifest's order.
const NO_LIGHT = { positionM: new Float32Array(0), irradiance: new Float32Array(0) };

/** A bake of a source (`fetch.js`). Anything that contradicts its manifest is an error. */
export class BakeStream {
  #present = new Map();

  /** Fetches all but the clusters. */
  static async begin(source, { signal = null } = {}) {
    const stream = new BakeStream();
    const manifest = await fetchManifest(source, { signal });
    checkRelightable(manifest);
    const decoded = (role, decode) => fetchChunks(source, chunksOf(manifest, role), decode, { signal });
    const geometry = await decoded(ROLES.geometry, decodeGeometry);
    const textures = await decoded(ROLES.textures, decodeTexture);
    [stream.patches] = await decoded(ROLES.patches, decodePatches);
    stream.overview = await decoded(ROLES.overview, decodeCluster);
    stream.source = source;
    stream.scene = assembleScene(manifest, geometry, textures);
    stream.chunks = chunksOf(manifest, ROLES.clusters);
    return stream;
  }

  /** Clusters that have come, and all. */
  get clusters() {
    return [this.#present.size, this.chunks.length];
  }

  /** Bytes of the chunks of clusters that have come, and of all. */
  get bytes() {
    const sum = (chunks) => chunks.reduce((bytes, chunk) => bytes + chunk.bytes, 0);
    return [sum([...this.#present.keys()].map((index) => this.chunks[index])), sum(this.chunks)];
  }

  get isWhole() {
    return this.#present.size === this.chunks.length;
  }

  /** The bake with the light of the clusters that have come; receivers of the overview stand for all others. */
  bake() {
    return { scene: this.scene, light: lightOfPrefix(this.scene, this.patches, this.overview, this.#present) };
  }

  /**
   * Fetches clusters until `bytesMax` bytes more have come, or one that is longer: those first that are needed most where there is
   * light, `lit` (see `byNeed`; that of a frame is `frame.lit()`), and from a viewpoint, `{positionM, forward}`. `onCluster` is called
   * for each that comes.
   */
  async refine(bytesMax, { lit = NO_LIGHT, viewpoint = null, signal = null, onCluster = () => {} } = {}) {
    const chosen = [];
    let bytes = 0;
    for (const index of this.#order(lit, viewpoint)) {
      const own = this.chunks[index].bytes;
      if (chosen.length > 0 && bytes + own > bytesMax) continue;
      chosen.push(index);
      bytes += own;
    }
    await forEachParallel(chosen.length, PARALLEL, async (at) => {
      const cluster = decodeCluster(await fetchChunk(this.source, this.chunks[chosen[at]], { signal }));
      this.#present.set(chosen[at], cluster);
      onCluster();
    });
  }

  /** Numbers of absent clusters by falling need. */
  #order(lit, viewpoint) {
    const absent = this.chunks.map((_, index) => index).filter((index) => !this.#present.has(index));
    const { clusters, boundsM } = this.scene.manifest;
    const candidates = absent.map((index) => {
      const { boundsM: bounds, receivers } = clusters[index];
      return { boundsM: bounds, receivers, bytes: this.chunks[index].bytes };
    });
    const reach = Math.hypot(...[0, 1, 2].map((axis) => boundsM[3 + axis] - boundsM[axis]));
    return byNeed(candidates, lit, viewpoint, reach).map((at) => absent[at]);
  }
}

/** Fetches all of a bake. */
export async function loadBake(source, options = {}) {
  const stream = await BakeStream.begin(source, options);
  await stream.refine(Infinity, options);
  return stream.bake();
}
