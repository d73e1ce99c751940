// A bake that is fetched piece by piece: its scene and the light of the overview first, then clusters; of a bake that goes on, the
// clusters that have landed, and no overview before its end.

import { ROLES, checkRelightable, chunksOf } from "../chunk/manifest.js";
import { PARALLEL, fetchManifest, fetchUnverified, forEachParallel } from "../fetch.js";
import { checkOutline, isLost } from "./following.js";
import { LightmapLayout } from "./layout.js";
import { openWork } from "./workers.js";

// Without known light, clusters come in the manifest's order.
const NO_LIGHT = { positionM: new Float32Array(0), irradiance: new Float32Array(0) };

/** A bake of a source (`fetch.js`). Anything that contradicts its manifest is an error. */
export class BakeStream {
  #work;
  // Numbers of the clusters that have come.
  #present = new Set();
  // Numbers of clusters of a bake that goes on whose bytes the server has lost, as far as they were asked for.
  #lost = new Set();
  // Those of them that are not asked for again before something lands.
  #passedOver = new Set();
  // A bake that goes on.
  #following = null;
  // Rows of the clusters to fetch, as the manifest lists them.
  #rows = [];

  /**
   * Fetches all but the clusters. `workers` is how many Workers decode, see `openWork`; with 0 all is done on this thread. They live
   * until `close`. `following` follows a bake that goes on, and has heard of its outline (`following.js`).
   */
  static async begin(source, { signal = null, workers, following = null } = {}) {
    const stream = new BakeStream();
    stream.source = source;
    const opened = openWork(workers);
    try {
      stream.#following = following;
      const manifest = following === null ? await fetchManifest(source, { signal }) : following.manifest;
      if (following === null) checkRelightable(manifest);
      stream.#work = await opened;
      await stream.#begin(manifest, signal);
    } catch (error) {
      (await opened).close();
      throw error;
    }
    return stream;
  }

  async #begin(manifest, signal) {
    const decoded = (role, kind) => this.#decoded(chunksOf(manifest, role), kind, signal);
    // None waits for another's answers, nor for its decoding.
    const [geometry, textures, [patches], overview] = await Promise.all([
      decoded(ROLES.geometry, "geometry"),
      decoded(ROLES.textures, "texture"),
      decoded(ROLES.patches, "patches"),
      decoded(ROLES.overview, "cluster"),
    ]);
    this.hasOverview = overview.length > 0;
    const textureCount = textures.length;
    const { draws, warnings } = await this.#work.begin({ manifest, geometry, textureCount, patches, overview });
    this.scene = { manifest, layout: new LightmapLayout(manifest), draws, textures, warnings };
    this.#list(manifest);
  }

  #list(manifest) {
    this.#rows = manifest.clusters;
    this.chunks = chunksOf(manifest, ROLES.clusters);
  }

  /** Whether the bake goes on: more is to come than `clusters` and `bytes` tell of. */
  get isUnderWay() {
    return this.#following !== null;
  }

  /** Of a bake that goes on, the cells whose clusters are baked, and all. */
  get cells() {
    return this.#following.cells;
  }

  /**
   * Hears of more of a bake that goes on, see `Following.hear`, and answers whether there is any: `refine` fetches it. At its end the bake
   * is as any other.
   */
  async hear({ waitSecs = 0, signal = null } = {}) {
    const news = await this.#following.hear({ waitSecs, signal });
    if (news === "more") {
      this.#list(this.#following.manifest);
      this.#passedOver.clear();
    }
    if (news === "done") await this.#end(signal);
    return news !== "none";
  }

  /** Goes on with the manifest of the bake, in whose order the clusters that have come are. */
  async #end(signal) {
    const manifest = await fetchManifest(this.source, { signal });
    checkRelightable(manifest);
    checkOutline(this.#following.manifest, manifest);
    const overview = await this.#decoded(chunksOf(manifest, ROLES.overview), "cluster", signal);
    const numberOf = new Map(chunksOf(manifest, ROLES.clusters).map(({ digest }, number) => [digest, number]));
    const numbers = [...this.#present]
      .map((number) => [number, numberOf.get(this.chunks[number].digest)])
      .filter(([, next]) => next !== undefined);
    await this.#work.end(numbers, overview);
    this.#present = new Set(numbers.map(([, next]) => next));
    this.#lost.clear();
    this.#passedOver.clear();
    this.#list(manifest);
    this.#following = null;
  }

  /** Fetches chunks, several at a time, and decodes them. */
  async #decoded(chunks, kind, signal) {
    const results = new Array(chunks.length);
    await forEachParallel(chunks.length, PARALLEL, async (index) => {
      results[index] = await this.#decode(chunks[index], kind, signal);
    });
    return results;
  }

  async #decode(chunk, kind, signal) {
    return this.#work.decode(kind, chunk.digest, await fetchUnverified(this.source, chunk, { signal }));
  }

  /** Clusters that have come, and all. */
  get clusters() {
    return [this.#present.size, this.chunks.length];
  }

  /** Clusters of a bake that goes on whose bytes the server has lost: they come once they are baked again. */
  get lost() {
    return this.#lost.size;
  }

  /** Bytes of the chunks of clusters that have come, and of all. */
  get bytes() {
    const sum = (chunks) => chunks.reduce((bytes, chunk) => bytes + chunk.bytes, 0);
    return [sum([...this.#present].map((index) => this.chunks[index])), sum(this.chunks)];
  }

  get isWhole() {
    return !this.isUnderWay && this.#present.size === this.chunks.length;
  }

  /** Whether Workers do the work, and not this thread. */
  get isElsewhere() {
    return this.#work.isElsewhere;
  }

  /** The bake with the light of the clusters that have come; receivers of the overview stand for all others. */
  async bake() {
    return { scene: this.scene, light: await this.#work.light(this.isWhole) };
  }

  /**
   * Fetches clusters until `bytesMax` bytes more have come, or one that is longer: those first that are needed most where there is
   * light, `lit` (see `byNeed`; that of a frame is `frame.lit()`), and from a viewpoint, `{positionM, forward}`. `onCluster` is called
   * for each that comes.
   */
  async refine(bytesMax, { lit = NO_LIGHT, viewpoint = null, signal = null, onCluster = () => {} } = {}) {
    for (let come = 0; ; ) {
      const passedOver = this.#passedOver.size;
      const chosen = [];
      let bytes = come;
      for (const index of await this.#order(lit, viewpoint)) {
        const own = this.chunks[index].bytes;
        if (bytes > 0 && bytes + own > bytesMax) continue;
        chosen.push(index);
        bytes += own;
      }
      come += await this.#fetch(chosen, signal, onCluster);
      // Others take the share of those that turned out to be lost.
      if (this.#passedOver.size === passedOver) return;
    }
  }

  /** Fetches clusters; answers the bytes of those that came. */
  async #fetch(chosen, signal, onCluster) {
    let come = 0;
    await forEachParallel(chosen.length, PARALLEL, async (at) => {
      const index = chosen[at];
      let decoded;
      try {
        decoded = await this.#decode(this.chunks[index], "cluster", signal);
      } catch (error) {
        // Bytes that were lost come again while the bake goes on, once their task has run again: others need not wait.
        if (!this.isUnderWay || !isLost(error)) throw error;
        this.#lost.add(index);
        this.#passedOver.add(index);
        return;
      }
      this.#lost.delete(index);
      await this.#work.add(index, decoded);
      this.#present.add(index);
      come += this.chunks[index].bytes;
      onCluster();
    });
    return come;
  }

  /** Numbers of absent clusters by falling need, but for those that are lost. */
  async #order(lit, viewpoint) {
    const isWanted = (index) => !this.#present.has(index) && !this.#passedOver.has(index);
    const absent = this.chunks.map((_, index) => index).filter(isWanted);
    const { boundsM } = this.scene.manifest;
    const candidates = absent.map((index) => {
      const { boundsM: bounds, receivers } = this.#rows[index];
      return { boundsM: bounds, receivers, bytes: this.chunks[index].bytes };
    });
    const reach = Math.hypot(...[0, 1, 2].map((axis) => boundsM[3 + axis] - boundsM[axis]));
    const order = await this.#work.byNeed(candidates, lit, viewpoint, reach);
    return order.map((at) => absent[at]);
  }

  /** Ends the Workers; nothing more is fetched or put together after it. */
  close() {
    this.#work.close();
  }
}

/** Fetches all of a bake. */
export async function loadBake(source, options = {}) {
  const stream = await BakeStream.begin(source, options);
  try {
    await stream.refine(Infinity, options);
    return await stream.bake();
  } finally {
    stream.close();
  }
}
