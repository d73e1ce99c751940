// Highest costs of reading an object: every size that a file can state is compared with one of these first. Twin of
// worker/src/scene/limits.rs, with less room for meshes: a page moves every vertex itself.

import { LimitError } from "./error.js";

const SPLIT = "split or simplify the object";
const SMALLER_TEXTURES = "make its textures smaller";

/** Limits, each with the words of a message. */
export const LIMITS = {
  fileBytes: { limit: 2 ** 28, what: "bytes of the file", remedy: SPLIT },
  jsonBytes: { limit: 2 ** 26, what: "bytes of JSON", remedy: "export without extras and unused objects" },
  nodes: { limit: 100_000, what: "nodes", remedy: SPLIT },
  nodeLevels: { limit: 256, what: "levels of nodes", remedy: "flatten the node hierarchy" },
  instances: { limit: 100_000, what: "mesh primitives in the scene", remedy: SPLIT },
  triangles: { limit: 4_000_000, what: "triangles", remedy: SPLIT },
  vertices: { limit: 12_000_000, what: "vertices", remedy: SPLIT },
  sparseElements: {
    limit: 12_000_000,
    what: "sparse accessor elements",
    remedy: "export the scene without sparse accessors",
  },
  zeroElements: {
    limit: 2 ** 20,
    what: "elements in an accessor without bytes",
    remedy: "export the scene with all its vertices",
  },
  texturePixels: { limit: 16_384 * 16_384, what: "pixels in a texture", remedy: SMALLER_TEXTURES },
};
// Pixels of all textures together: so many in any file, as many more for each byte of it, and never more than the last.
const PIXELS_FREE = 2 ** 27;
const PIXELS_PER_BYTE = 64;
const PIXELS_MOST = 2 ** 30;
// Bytes of compressed meshes together once decompressed, likewise. Meshes have up to 20 for each of theirs, zeros 1024; a page stands
// still while it decompresses some 100 million a second.
const DECODED_FREE = 2 ** 25;
const DECODED_PER_BYTE = 32;
const DECODED_MOST = 2 ** 28;

/** Compares one stated size with its limit. */
export function within({ limit, what, remedy }, found) {
  if (found > limit) throw new LimitError(`too many ${what}: ${found} (at most ${limit}); ${remedy}`);
}

/** Limit of what the meshes of a file of so many bytes decompress to. */
export function decodedLimit(fileBytes) {
  const limit = Math.min(DECODED_FREE + DECODED_PER_BYTE * fileBytes, DECODED_MOST);
  return { limit, what: "bytes of decompressed meshes", remedy: SPLIT };
}

/** Running totals that may not pass their limits. */
export class Budgets {
  #used = new Map();

  constructor(fileBytes) {
    const limit = Math.min(PIXELS_FREE + PIXELS_PER_BYTE * fileBytes, PIXELS_MOST);
    this.pixels = { limit, what: "pixels in all textures", remedy: SMALLER_TEXTURES };
  }

  /** Adds a count, or says that the limit is passed. To be called before work or room for so many. */
  spend(of, count) {
    const used = (this.#used.get(of) ?? 0) + count;
    within(of, used);
    this.#used.set(of, used);
  }
}
