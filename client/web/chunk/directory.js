// Pages of a bake's directory (chunk kind 6), FORMAT.md "Directory".
//
// A decoded page is `{rows, chunks}`, of each cluster one. A row mirrors `ClusterRow` of proto/src/manifest/clusters.rs:
//
// {
//   boundsM: Float32Array(6), receivers, keys, rank,
//   truncationError, quantisationError, uncoveredFraction,
//   layers: [{bytes, level, bands, rank}],         coarsest first; the last is the whole chunk
//   checks: [hex of 8 bytes],                      of each layer's prefix but the last: the first of its digest
// }
//
// and a chunk is `{digest: hex, bytes}`.

import { Reader } from "./bytes.js";
import { Container, sectionId } from "./container.js";
import { allFinite, inRange } from "./error.js";
import { hexOf } from "./digest.js";
import { bytesMax, takeF32Planes, takeU32s } from "./ints.js";
import {
  BANDS_MAX, CHUNK_BYTES_MAX, CLUSTER_KEYS_MAX, DIRECTORY_CLUSTERS_MAX, LAYERS_MAX, LEVELS_MAX, RANK_MAX, RECEIVERS_MAX,
} from "./limits.js";

/** Number of the kind in a chunk's header. */
export const DIRECTORY = 6;
const SECTION = "directory";
const DIGEST_BYTES = 32;
const CHECK_BYTES = 8;
/** Bounds and errors of a row, as numbers. */
const NUMBERS = 9;

/** Decodes a page. */
export function decodeDirectory(bytes) {
  const container = new Container(DIRECTORY, bytes);
  const head = new Reader("directory head", container.head);
  const [clusters, layers] = [head.u32("clusters"), head.u32("layers")];
  head.end();
  inRange("directory head", "clusters", clusters, 0, DIRECTORY_CLUSTERS_MAX);
  inRange("directory head", "layers", layers, clusters, clusters * LAYERS_MAX);
  container.checkSections([sectionId(1)]);
  const rawMax =
    DIGEST_BYTES * clusters +
    CHECK_BYTES * (layers - clusters) +
    (4 + NUMBERS) * bytesMax(clusters) +
    4 * bytesMax(layers);
  const reader = new Reader(SECTION, container.section(0, SECTION, rawMax));
  const columns = readColumns(reader, clusters, layers);
  const found = rowsOf(columns, clusters);
  reader.end();
  return found;
}

function readColumns(reader, clusters, layers) {
  const digests = hexes(reader.take("digest", clusters, DIGEST_BYTES), DIGEST_BYTES);
  const ofClusters = (what) => takeU32s(reader, what, clusters);
  const [receivers, keys, rank, more] = ["receivers", "column keys", "rank", "layers"].map(ofClusters);
  const all = more.reduce((sum, of) => sum + of + 1, 0);
  inRange(SECTION, "layers of all clusters", all, layers, layers);
  const ofLayers = (what) => takeU32s(reader, `${what} of a layer`, layers);
  const [grown, level, bands, ranks] = ["bytes", "level", "bands", "rank"].map(ofLayers);
  const checks = hexes(reader.take("check", layers - clusters, CHECK_BYTES), CHECK_BYTES);
  const ofNumber = () => takeF32Planes(reader, "bounds or error", clusters);
  const numbers = Array.from({ length: NUMBERS }, ofNumber);
  return { digests, receivers, keys, rank, more, grown, level, bands, ranks, checks, numbers };
}

function hexes(bytes, size) {
  return Array.from({ length: bytes.length / size }, (_, index) => hexOf(bytes.subarray(index * size, (index + 1) * size)));
}

function rowsOf(columns, clusters) {
  const { digests, grown, level, bands, ranks, checks, numbers } = columns;
  const [rows, chunks] = [[], []];
  let next = 0;
  for (let index = 0; index < clusters; index++) {
    const first = next;
    next += columns.more[index] + 1;
    let bytes = 0;
    const layers = Array.from({ length: next - first }, (_, place) => {
      const at = first + place;
      bytes += grown[at];
      return { bytes, level: level[at], bands: bands[at], rank: ranks[at] };
    });
    const [truncationError, quantisationError, uncoveredFraction] = numbers.slice(6).map((column) => column[index]);
    const row = {
      boundsM: Float32Array.from({ length: 6 }, (_, column) => numbers[column][index]),
      receivers: columns.receivers[index],
      keys: columns.keys[index],
      rank: columns.rank[index],
      truncationError,
      quantisationError,
      uncoveredFraction,
      layers,
      // Clusters before it have as many checks as layers, less one each.
      checks: checks.slice(first - index, next - index - 1),
    };
    rows.push(row);
    chunks.push({ digest: digests[index], bytes });
  }
  rows.forEach((row, index) => checkRow(row, chunks[index]));
  return { rows, chunks };
}

/** Throws unless a row fits its chunk. */
function checkRow(row, chunk) {
  const layers = row.layers.length;
  inRange(SECTION, "layers of a cluster", layers, 1, LAYERS_MAX);
  inRange(SECTION, "checks of a cluster's prefixes", row.checks.length, layers - 1, layers - 1);
  const errors = [row.truncationError, row.quantisationError, row.uncoveredFraction];
  allFinite(SECTION, "bounds or error", [...row.boundsM, ...errors]);
  let least = 1;
  for (const layer of row.layers) {
    inRange(SECTION, "bytes of a layer", layer.bytes, least, CHUNK_BYTES_MAX);
    inRange(SECTION, "level of a layer", layer.level, 0, LEVELS_MAX - 1);
    inRange(SECTION, "bands of a layer", layer.bands, 0, BANDS_MAX);
    inRange(SECTION, "rank of a layer", layer.rank, 0, RANK_MAX);
    least = layer.bytes + 1;
  }
  inRange(SECTION, "bytes of the last layer", least - 1, chunk.bytes, chunk.bytes);
  inRange(SECTION, "receivers of a cluster", row.receivers, 0, RECEIVERS_MAX);
  inRange(SECTION, "column keys of a cluster", row.keys, 0, CLUSTER_KEYS_MAX);
  inRange(SECTION, "rank of a cluster", row.rank, 0, RANK_MAX);
}
