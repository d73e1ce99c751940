// Clusters (chunk kind 1): receivers that share one factorised transport matrix A ≈ U (ΣVᵀ), FORMAT.md "Cluster".
//
// A decoded cluster mirrors `ClusterTransport` of proto/src/content/cluster.rs. R receivers, rank k, n columns, m near hits; vectors
// lie flat, one after the other:
//
// {
//   boundsM: Float32Array(6),                  lower corner x, y, z, upper corner x, y, z, metres
//   receivers: {                               coarse levels first
//     length: R,
//     blocks: BigUint64Array,                  keys; `block` indexes them
//     block: Uint16Array(R),
//     texel: Uint16Array(2R),
//     positionM, normal, albedo, emission: Float32Array(3R),
//     links: Uint8Array(R), coverage: Uint16Array(R), edge: Uint16Array(R),
//   },
//   factors: {
//     keys: BigUint64Array,                    of the columns, ascending (see patch_key.js)
//     bands, sky: boolean, rank: k,
//     u: Float32Array(R·k),                    row-major: u[r·k + i]
//     vt: Float32Array(k·n),                   rank-major: vt[i·n + column]
//     steps: {u: Float32Array(k), vt: Float32Array(k), scale: Float32Array(n) or empty where all are 1},
//   },
//   emitters: [{emitter, irradiance: Float32Array(3R)}],
//   near: {
//     length: m, reachM,
//     count: Uint8Array(R) or empty, weight: Float32Array(R) or empty,    of each receiver
//     blocks: BigUint64Array,
//     surface: {isOwn: Uint8Array(m), block: Uint16Array(m), texel: Uint16Array(2m), albedo, normal: Float32Array(3m)},
//     offset: Int16Array(3m),                  shares of the reach of 1/NEAR_STEPS
//   },
// }

import { Reader } from "./bytes.js";
import {
  BEGIN_BYTES_MAX, HIT_BYTES, emptyNear, nearBytesMax, readBegin, readNear,
} from "./cluster_near.js";
import { readClusterHead } from "./cluster_head.js";
import { PALETTE_MAX, ReceiverCodec, emptyReceivers, readIrradiance, receiversBytesMax } from "./cluster_receivers.js";
import { ascendingKeys } from "./column_keys.js";
import { Container, sectionId } from "./container.js";
import { ChunkError, allNumbers, inRange, orderError } from "./error.js";
import { FactorDecoder, baseBytesMax, layerBytesMax, layerDecodedBytes } from "./factors.js";
import { Predictor } from "./predict.js";

export { NEAR_STEPS, NEAR_STEPS_STORED } from "./cluster_near.js";

/** Number of the kind in a chunk's header. */
export const CLUSTER = 1;
const TAGS = { base: 1, receivers: 2, factors: 3, factorsLow: 4, near: 5 };

/** Decodes a whole cluster chunk. */
export function decodeCluster(bytes) {
  return decode(new Container(CLUSTER, bytes), bytes.length).cluster;
}

/**
 * Decodes the largest layer that lies fully in `bytes`, the first bytes of a chunk of `totalBytes`: `{cluster, layer}`, the latter
 * `{bytes, level, bands, rank}`. Throws if not even the smallest layer is there.
 */
export function decodeClusterPrefix(bytes, totalBytes) {
  return decode(new Container(CLUSTER, bytes, totalBytes), totalBytes);
}

/** Layers of a cluster chunk, `{bytes, level, bands, rank}` each, from its first bytes: header, head and section table. */
export function clusterLayers(bytes, totalBytes) {
  const container = new Container(CLUSTER, bytes, totalBytes);
  const head = readClusterHead(container.head, container.entries.length);
  checkSections(container, head);
  return head.layers.map(({ sections, layer }) => ({ bytes: container.endOf(sections), ...layer }));
}

function decode(container, totalBytes) {
  const head = readClusterHead(container.head, container.entries.length);
  checkSections(container, head);
  const last = head.layers.findLastIndex(({ sections }) => sections <= container.complete);
  if (last < 0) {
    const wanted = Math.min(container.endOf(head.layers[0].sections), totalBytes);
    const message = `chunk: smallest layer needs ${wanted} bytes at offset 0, ${container.bytes.length} are left`;
    throw new ChunkError("truncated", message, { section: "chunk", what: "smallest layer" });
  }
  const { sections, layer } = head.layers[last];
  container.checkExpansion(decodedBytes(head, layer));
  const decoder = new Decoder(head, layer);
  decoder.base(container.section(0, "base", decoder.baseBytesMax()));
  for (let index = 0; index <= last; index++) decoder.layer(container, index);
  return { cluster: decoder.cluster, layer: { bytes: container.endOf(sections), ...layer } };
}

/** Throws unless the sections are those of each layer in turn, in their order. */
function checkSections(container, head) {
  const wanted = [];
  head.layers.forEach(({ sections }, index) => {
    const used = [TAGS.base, TAGS.receivers, TAGS.factors, TAGS.factorsLow, TAGS.near];
    const tags = used.slice(index > 0 ? 1 : 0, head.near ? used.length : -1);
    tags.forEach((tag) => wanted.push(sectionId(tag, [index, 0, 0])));
    inRange("cluster head", "layer's sections", sections, wanted.length, wanted.length);
  });
  container.checkSections(wanted);
}

/** Memory that a decoded layer takes, about: as in Rust, so that the same chunks are refused. */
function decodedBytes(head, layer) {
  const receivers = head.shape.receiversIn(layer.level);
  return layerDecodedBytes(head.shape, layer) + receivers * (65 + 12 * head.emitters) + 8 * head.blocks;
}

/** A cluster that fills up layer by layer. All counts of `head` have been checked against their limits. */
class Decoder {
  constructor(head, layer) {
    const receivers = head.shape.receiversIn(layer.level);
    this.head = head;
    this.codec = new ReceiverCodec(head.boundsM, head.shape.levels, receivers);
    this.predictor = new Predictor(receivers);
    this.factors = new FactorDecoder(head.shape, layer);
    this.cluster = {
      boundsM: head.boundsM,
      receivers: emptyReceivers(receivers),
      factors: this.factors.factors,
      emitters: [],
      near: emptyNear(head.near ? receivers : 0),
    };
  }

  /** Reads the sections of layer number `index`, but the base. */
  layer(container, index) {
    const { head } = this;
    const { sections: end, layer } = head.layers[index];
    const sections = end - (head.near ? 1 : 0);
    const before = index === 0 ? null : head.layers[index - 1].layer;
    const levels = head.shape.newLevels(before, layer);
    const counts = levels.map((level) => head.shape.counts[level]);
    const bytesMax = counts.reduce((sum, count) => sum + receiversBytesMax(count, head.blocks, head.emitters), 0);
    const start = this.cluster.receivers.length;
    this.receivers(container.section(sections - 3, "receivers", bytesMax), levels);
    const [highMax, lowMax] = layerBytesMax(head.shape, before, layer);
    const high = container.section(sections - 2, "factors", highMax);
    const low = container.section(sections - 1, "low parts", lowMax);
    this.factors.layer([high, low], before, layer, this.predictor);
    if (head.near) this.near(container, index, counts, start);
  }

  /** Reads the near hits of layer number `index`, its last section; its receivers begin at `start`. */
  near(container, index, counts, start) {
    const { head, cluster } = this;
    const place = head.layers[index].sections - 1;
    const content = decodedBytes(head, head.shape.full());
    container.checkExpansion(content + container.rawBytes(place));
    const bytesMax = nearBytesMax(counts) + (index === 0 ? BEGIN_BYTES_MAX : 0);
    const reader = new Reader("near hits", container.section(place, "near hits", bytesMax));
    if (index === 0) readBegin(reader, cluster.near);
    const without = content + 8 * cluster.near.blocks.length;
    let at = start;
    for (const count of counts) {
      const mayTake = (hits) => container.checkExpansion(without + HIT_BYTES * hits);
      readNear(reader, cluster.near, at, count, mayTake);
      at += count;
    }
    reader.end();
  }

  receivers(raw, levels) {
    const { head, cluster } = this;
    const reader = new Reader("receivers", raw);
    for (const level of levels) {
      const count = head.shape.counts[level];
      const start = cluster.receivers.length;
      this.codec.read(reader, cluster.receivers, count, level, this.predictor);
      for (const { irradiance } of cluster.emitters) readIrradiance(reader, irradiance, start, count);
    }
    reader.end();
  }

  baseBytesMax() {
    const { blocks, emitters, shape } = this.head;
    return baseBytesMax(shape) + 8 * blocks + 2 * emitters + 2 + 12 * PALETTE_MAX;
  }

  base(raw) {
    const { head, cluster } = this;
    const reader = new Reader("base", raw);
    cluster.receivers.blocks = ascendingKeys(reader, "block", head.blocks);
    this.factors.base(reader);
    for (let index = 0; index < head.emitters; index++) {
      const emitter = reader.u16("emitter");
      if (index > 0 && cluster.emitters[index - 1].emitter >= emitter) throw orderError("base", "emitter", index);
      const irradiance = new Float32Array(cluster.receivers.positionM.length);
      cluster.emitters.push({ emitter, irradiance });
    }
    const count = inRange("base", "palette length", reader.u16("palette length"), 0, PALETTE_MAX);
    const palette = reader.f32s("palette", 3 * count);
    allNumbers("base", "palette", palette, "0 to below 1", (albedo) => albedo >= 0 && albedo < 1);
    this.codec.palette = palette;
    reader.end();
  }
}
