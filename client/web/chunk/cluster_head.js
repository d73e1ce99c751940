// The head of a cluster chunk: counts and layers, uncompressed.

import { Reader } from "./bytes.js";
import { inRange, orderError } from "./error.js";
import { BAND_GROUP_LASTS, FactorShape, RANK_GROUP_ENDS } from "./layers.js";
import {
  BLOCKS_MAX, EMITTERS_MAX, EMITTER_ENTRIES_MAX, LAYERS_MAX, LEVELS_MAX, RECEIVERS_MAX,
} from "./limits.js";

const SECTION = "cluster head";

/**
 * Reads and checks a head: `{boundsM, shape, blocks, emitters, near, layers}`; layers, coarsest first, are
 * `{sections, layer: {level, bands, rank}}`.
 */
export function readClusterHead(bytes, sectionCount) {
  const reader = new Reader(SECTION, bytes);
  const boundsM = Float32Array.from({ length: 6 }, () => reader.f32("bounds"));
  const counts = Array.from({ length: LEVELS_MAX }, () =>
    inRange(SECTION, "receivers of a level", reader.u32("receivers of a level"), 0, RECEIVERS_MAX),
  );
  const keys = reader.u32("column keys");
  const blocks = reader.u32("blocks");
  const emitters = reader.u16("emitters");
  const [levels, bands, rank] = [reader.u8("levels"), reader.u8("bands"), reader.u8("rank")];
  const sky = inRange(SECTION, "sky flag", reader.u8("sky flag"), 0, 1) === 1;
  const layerCount = reader.u8("layer count");
  const near = inRange(SECTION, "near flag", reader.u8("near flag"), 0, 1) === 1;
  const shape = new FactorShape(counts, { levels, keys, sky, bands, rank });
  const head = { boundsM, shape, blocks, emitters, near, layers: [] };
  checkHead(head);
  inRange(SECTION, "layer count", layerCount, 1, LAYERS_MAX);
  head.layers = readLayers(reader, layerCount, shape, sectionCount);
  reader.end();
  return head;
}

function checkHead({ boundsM, shape, blocks, emitters }) {
  shape.check(SECTION);
  const axis = [0, 1, 2].find((axis) => boundsM[axis] > boundsM[3 + axis]);
  if (axis !== undefined) throw orderError(SECTION, "bounds on axis", axis);
  inRange(SECTION, "blocks", blocks, 0, BLOCKS_MAX);
  inRange(SECTION, "emitters", emitters, 0, EMITTERS_MAX);
  inRange(SECTION, "irradiances of emitters", emitters * shape.receiversIn(0), 0, EMITTER_ENTRIES_MAX);
}

function readLayers(reader, count, shape, sectionCount) {
  const layers = [];
  for (let index = 0; index < count; index++) {
    const entry = readLayer(reader, shape, index);
    const before = layers[index - 1];
    if (before !== undefined && !isNested(before, entry)) throw orderError(SECTION, "layer", index);
    layers.push(entry);
  }
  const { sections, layer } = layers[count - 1];
  const full = shape.full();
  const isAll = layer.level === full.level && layer.bands === full.bands && layer.rank === full.rank;
  if (sections !== sectionCount || !isAll) {
    throw orderError(SECTION, "layer (the last is not everything)", count - 1);
  }
  return layers;
}

function readLayer(reader, shape, index) {
  const sections = reader.u16("layer's sections");
  const [level, bands, rank] = [reader.u8("layer"), reader.u8("layer"), reader.u8("layer")];
  inRange(SECTION, "layer's level", level, 0, shape.levels - 1);
  inRange(SECTION, "layer's bands", bands, 0, shape.bands);
  inRange(SECTION, "layer's rank", rank, 0, shape.rank);
  const isAligned =
    RANK_GROUP_ENDS.some((end) => Math.min(end, shape.rank) === rank) &&
    BAND_GROUP_LASTS.some((last) => Math.min(last, shape.bands) === bands);
  if (!isAligned) throw orderError(SECTION, "layer (not on group bounds)", index);
  if (reader.take("reserved", 3).some((byte) => byte !== 0)) {
    throw orderError(SECTION, "layer (reserved bytes are set)", index);
  }
  return { sections, layer: { level, bands, rank } };
}

function isNested(before, { sections, layer }) {
  return (
    before.sections < sections &&
    before.layer.level >= layer.level &&
    before.layer.bands <= layer.bands &&
    before.layer.rank <= layer.rank
  );
}
