// The table of the chunk kinds that are read here.

import { CLUSTER, decodeCluster } from "./cluster.js";
import { kindOf } from "./container.js";
import { DIRECTORY, decodeDirectory } from "./directory.js";
import { ChunkError } from "./error.js";
import { GEOMETRY, decodeGeometry } from "./geometry.js";
import { PATCHES, decodePatches } from "./patches.js";
import { TEXTURE, decodeTexture } from "./texture.js";

/** Kinds by the number in a chunk's header: `{name, decode}`. */
export const CHUNK_KINDS = new Map([
  [CLUSTER, { name: "cluster", decode: decodeCluster }],
  [GEOMETRY, { name: "geometry", decode: decodeGeometry }],
  [TEXTURE, { name: "texture", decode: decodeTexture }],
  [PATCHES, { name: "patches", decode: decodePatches }],
  [DIRECTORY, { name: "directory", decode: decodeDirectory }],
]);

/** Decodes a whole chunk of any kind: `{name, content}`. */
export function decodeChunk(bytes) {
  const kind = kindOf(bytes);
  const row = CHUNK_KINDS.get(kind);
  if (row === undefined) {
    throw new ChunkError("unknown_kind", `chunk kind ${kind} is not known; a newer kiln may read it`);
  }
  return { name: row.name, content: row.decode(bytes) };
}
