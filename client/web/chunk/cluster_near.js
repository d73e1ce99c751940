// Near hits of a cluster chunk: of receivers in narrow places, points that light is read at one by one.

import { allNumbers, inRange } from "./error.js";
import { ascendingKeys } from "./column_keys.js";
import { bytesMax, takeDeltas, takeU32s } from "./ints.js";
import { BLOCKS_MAX, NEAR_HITS_MAX } from "./limits.js";
import { albedoOf, putNormal } from "./numbers.js";

/** Steps of an offset along the reach. */
export const NEAR_STEPS = 2047;
/** Offsets are stored in multiples of so many steps. */
export const NEAR_STEPS_STORED = 8;
/** Code of the whole hemisphere's weight π. */
const WEIGHT_CODE_MAX = 65_535;
const NORMAL_CODE_MAX = 32_767;
const HITS_OF_RECEIVER_MAX = 255;
const REACH_MAX_M = 1e4;
const PI = Math.fround(Math.PI);
/** Memory that a decoded hit takes: as in Rust, so that the same chunks are refused. */
export const HIT_BYTES = 34;

/** No hits of `count` receivers: the shape is that of `cluster.near` in `cluster.js`. */
export function emptyNear(count) {
  return {
    reachM: 0,
    count: new Uint8Array(count),
    weight: new Float32Array(count),
    blocks: new BigUint64Array(0),
    surface: emptySurface(0),
    offset: new Int16Array(0),
    length: 0,
  };
}

function emptySurface(hits) {
  return {
    isOwn: new Uint8Array(hits),
    block: new Uint16Array(hits),
    texel: new Uint16Array(2 * hits),
    albedo: new Float32Array(3 * hits),
    normal: new Float32Array(3 * hits),
  };
}

/** Most raw bytes of the hits of levels of so many receivers, without the begin of the first section. */
export function nearBytesMax(counts) {
  const receivers = counts.reduce((sum, count) => sum + count, 0);
  const hits = Math.min(receivers * HITS_OF_RECEIVER_MAX, NEAR_HITS_MAX);
  return 2 * bytesMax(receivers) + 12 * bytesMax(hits) + 14 * counts.length;
}

/** Most raw bytes of the begin of the first section. */
export const BEGIN_BYTES_MAX = 8 + 8 * BLOCKS_MAX;

/** Reads the begin of the first section: reach and blocks. */
export function readBegin(reader, near) {
  const { section } = reader;
  near.reachM = reader.f32("reach of near hits");
  const isReach = (reach) => reach > 0 && reach <= REACH_MAX_M;
  allNumbers(section, "reach of near hits", [near.reachM], "above 0 to 1e4", isReach);
  const what = "blocks of near hits";
  const blocks = inRange(section, what, reader.u32(what), 0, BLOCKS_MAX);
  near.blocks = ascendingKeys(reader, "block of near hits", blocks);
}

/** Reads the hits of receivers `start..start + count`; `mayTake` throws if as many hits are too many. */
export function readNear(reader, near, start, count, mayTake) {
  const { section } = reader;
  const counts = takeU32s(reader, "near hits", count);
  counts.forEach((of) => inRange(section, "near hits of a receiver", of, 0, HITS_OF_RECEIVER_MAX));
  near.count.set(counts, start);
  const added = counts.reduce((sum, of) => sum + of, 0);
  const first = near.length;
  mayTake(inRange(section, "near hits", first + added, 0, NEAR_HITS_MAX));
  readWeights(reader, near, start, counts);
  const isOwn = takeU32s(reader, "flag of a near hit", added);
  isOwn.forEach((flag) => inRange(section, "flag of a near hit", flag, 0, 1));
  grow(near, first + added);
  readSurfaces(reader, near, first, isOwn);
  readOffsets(reader, near, first, added);
}

function readWeights(reader, near, start, counts) {
  const what = "weight of near hits";
  const isLit = (count) => count > 0;
  const weights = takeU32s(reader, what, counts.filter(isLit).length);
  let at = 0;
  counts.forEach((count, row) => {
    const code = isLit(count) ? weights[at++] : 0;
    inRange(reader.section, what, code, 0, WEIGHT_CODE_MAX);
    near.weight[start + row] = Math.fround(code / WEIGHT_CODE_MAX) * PI;
  });
}

/** Makes room for `hits` hits. */
function grow(near, hits) {
  const before = near.surface;
  near.surface = emptySurface(hits);
  for (const name of Object.keys(before)) near.surface[name].set(before[name]);
  const offset = new Int16Array(3 * hits);
  offset.set(near.offset);
  near.offset = offset;
  near.length = hits;
}

function readSurfaces(reader, near, first, isOwn) {
  const own = isOwn.reduce((sum, flag) => sum + flag, 0);
  const codes = (what, count, min, max) => takeDeltas(reader, what, count, min, max);
  const onTexels = isOwn.length - own;
  const blocks = codes("block of a near hit", onTexels, 0, near.blocks.length - 1);
  const [x, y] = [0, 1].map(() => codes("texel of a near hit", onTexels, 0, 0xffff));
  const normals = [0, 1].map(() => codes("normal of a near hit", own, -NORMAL_CODE_MAX, NORMAL_CODE_MAX));
  const albedos = [0, 1, 2].map(() => codes("albedo of a near hit", own, 0, 255));
  const { surface } = near;
  let [texel, other] = [0, 0];
  isOwn.forEach((flag, index) => {
    const hit = first + index;
    surface.isOwn[hit] = flag;
    if (flag === 1) {
      putNormal(surface.normal, 3 * hit, normals[0][other], normals[1][other]);
      albedos.forEach((channel, at) => (surface.albedo[3 * hit + at] = albedoOf(channel[other])));
      other++;
    } else {
      surface.block[hit] = blocks[texel];
      surface.texel[2 * hit] = x[texel];
      surface.texel[2 * hit + 1] = y[texel];
      texel++;
    }
  });
}

function readOffsets(reader, near, first, count) {
  const most = Math.floor(NEAR_STEPS / NEAR_STEPS_STORED);
  for (let axis = 0; axis < 3; axis++) {
    const codes = takeDeltas(reader, "offset of a near hit", count, -most, most);
    codes.forEach((code, index) => (near.offset[3 * (first + index) + axis] = code * NEAR_STEPS_STORED));
  }
}
