// Work on a bake's chunks that needs neither network nor device: chunks → flat tables of light. It runs in a Worker (`worker.js`), or
// where there is none on the page's own thread, by the same calls.

import { decodeCluster } from "../chunk/cluster.js";
import { verify } from "../chunk/digest.js";
import { decodeGeometry } from "../chunk/geometry.js";
import { decodePatches } from "../chunk/patches.js";
import { decodeTexture } from "../chunk/texture.js";
import { assembleScene } from "./bake.js";
import { byNeed } from "./need.js";
import { lightOfPrefix } from "./prefix.js";

const DECODERS = { cluster: decodeCluster, geometry: decodeGeometry, patches: decodePatches, texture: decodeTexture };

export class LightWork {
  #scene;
  #patches;
  #overview;
  #present = new Map();

  /** Decodes the bytes of a chunk, which are held against its digest. */
  decode(kind, digest, bytes) {
    verify(digest, bytes);
    return DECODERS[kind](bytes);
  }

  /** Takes all but the clusters, of textures their number alone; gives the meshes to draw, `{draws, warnings}`. */
  begin({ manifest, geometry, textureCount, patches, overview }) {
    this.#scene = assembleScene(manifest, geometry, new Array(textureCount));
    [this.#patches, this.#overview] = [patches, overview];
    const { draws, warnings } = this.#scene;
    return { draws, warnings };
  }

  /** Takes a decoded cluster by its number in the manifest. */
  add(index, cluster) {
    this.#present.set(index, cluster);
  }

  /** Other numbers of the clusters that have come, `[number, next]` each, and the overview: those of a bake that is done. */
  end(numbers, overview) {
    const clusters = numbers.map(([number, next]) => [next, this.#present.get(number)]);
    [this.#present, this.#overview] = [new Map(clusters), overview];
  }

  /** Light of the clusters that have come, see `lightOfPrefix`. */
  light(isWhole) {
    return lightOfPrefix(this.#scene, this.#patches, this.#overview, this.#present, isWhole);
  }

  /** See `byNeed`. */
  byNeed(...args) {
    return byNeed(...args);
  }
}
