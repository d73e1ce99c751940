// The surface patches of a bake (chunk kind 5), FORMAT.md "Patches": which receivers each is the mean of.
//
// A decoded set mirrors `PatchSet` of proto/src/content/patches.rs; P patches, F leaves, R receivers, columns instead of rows:
//
// {
//   patches: {length: P, key: BigUint64Array(P), firstLeaf, leafCount: Uint32Array(P)},    ascending by key
//   leafStarts: Uint32Array(F + 1),                first receiver of each leaf, and the end
//   blocks: BigUint64Array, block: Uint32Array(R), texel: Uint16Array(2R),
//   area: Uint8Array(R),                           codes: `areaTexels` gives the area
//   skyParts,
// }

import { Reader } from "./bytes.js";
import { ascendingKeys } from "./column_keys.js";
import { Container, sectionId } from "./container.js";
import { inRange, orderError } from "./error.js";
import { bytesMax, takeDeltas, takeU32s } from "./ints.js";
import { PATCHES_MAX, PATCH_BLOCKS_MAX, PATCH_LEVELS_MAX, PATCH_RECEIVERS_MAX, SKY_PARTS_MAX } from "./limits.js";

/** Number of the kind in a chunk's header. */
export const PATCHES = 5;
const LEVEL_MAX = 14;
const DIRECTION_MAX = 5;

/** Area of a code in texels: `2^((code − 128)/16)`, from 1/256 to 244. */
export function areaTexels(code) {
  return Math.fround(2 ** ((code - 128) / 16));
}

/** Decodes patches. */
export function decodePatches(bytes) {
  const container = new Container(PATCHES, bytes);
  const head = new Reader("patches head", container.head);
  const names = ["patches", "leaves", "receivers", "blocks", "parts of the sky"];
  const [patches, leaves, receivers, blocks, skyParts] = names.map((what) => head.u32(what));
  head.end();
  checkCounts("patches head", { patches, leaves, receivers, blocks });
  container.checkSections([sectionId(1), sectionId(2)]);
  container.checkExpansion(2 * (16 * patches + 4 * leaves + 9 * receivers + 8 * blocks));
  const patchBytes = 8 * blocks + 4 * bytesMax(patches);
  const set = readPatches(container.section(0, "patches", patchBytes), blocks, patches, leaves);
  const leafBytes = bytesMax(leaves) + 3 * bytesMax(receivers) + receivers;
  Object.assign(set, readLeaves(container.section(1, "leaves", leafBytes), leaves, receivers), { skyParts });
  check(set);
  return set;
}

function checkCounts(section, { patches, leaves, receivers, blocks }) {
  inRange(section, "receivers of patches", receivers, 0, PATCH_RECEIVERS_MAX);
  inRange(section, "leaves", leaves, 0, receivers);
  inRange(section, "patches", patches, 0, PATCHES_MAX);
  inRange(section, "blocks", blocks, 0, PATCH_BLOCKS_MAX);
}

function readPatches(raw, blockCount, count, leaves) {
  const reader = new Reader("patches", raw);
  const blocks = ascendingKeys(reader, "block", blockCount);
  const low = takeU32s(reader, "key", count);
  const high = takeU32s(reader, "key", count);
  const first = takeDeltas(reader, "first leaf", count, 0, leaves);
  const extra = takeU32s(reader, "leaves of a patch", count);
  reader.end();
  const key = keysOf(low, high);
  const leafCount = extra.map((more) => Math.min(more + 1, 0xffff_ffff));
  return { patches: { length: count, key, firstLeaf: new Uint32Array(first.buffer), leafCount }, blocks };
}

/** Keys of which these are the halves of the differences: sums of 64 bits without a carry out of them. */
function keysOf(low, high) {
  const keys = new BigUint64Array(low.length);
  const halves = new Uint32Array(keys.buffer);
  let [lowSum, highSum] = [0, 0];
  for (let index = 0; index < low.length; index++) {
    lowSum += low[index];
    const carry = lowSum >= 2 ** 32 ? 1 : 0;
    lowSum -= carry * 2 ** 32;
    highSum += high[index] + carry;
    const isStep = index === 0 || low[index] > 0 || high[index] > 0;
    if (!isStep || highSum >= 2 ** 32) throw orderError("patches", "patch", index);
    halves[2 * index] = lowSum;
    halves[2 * index + 1] = highSum;
  }
  return keys;
}

function readLeaves(raw, leaves, receivers) {
  const reader = new Reader("leaves", raw);
  const sizes = takeU32s(reader, "receivers of a leaf", leaves);
  const block = takeDeltas(reader, "block", receivers, 0, PATCH_BLOCKS_MAX - 1);
  const [x, y] = [0, 1].map(() => takeDeltas(reader, "texel", receivers, 0, 65_535));
  const area = reader.take("area", receivers).slice();
  reader.end();
  const leafStarts = new Uint32Array(leaves + 1);
  for (let leaf = 0; leaf < leaves; leaf++) {
    const end = leafStarts[leaf] + sizes[leaf] + 1;
    leafStarts[leaf + 1] = inRange("leaves", "end of a leaf", end, 1, receivers);
  }
  const texel = new Uint16Array(2 * receivers);
  for (let index = 0; index < receivers; index++) {
    texel[2 * index] = x[index];
    texel[2 * index + 1] = y[index];
  }
  return { leafStarts, block: new Uint32Array(block.buffer), texel, area };
}

/** Throws unless every index is in range and nothing is empty. */
function check({ patches, leafStarts, block, texel, blocks, skyParts }) {
  const section = "patches";
  const leaves = leafStarts.length - 1;
  const receivers = texel.length / 2;
  let ones = 0;
  for (let rest = skyParts; rest !== 0; rest = (rest & (rest - 1)) >>> 0) ones++;
  inRange(section, "parts of the sky (log2 of a power of two)", ones, 1, 1);
  inRange(section, "parts of the sky", skyParts, 1, SKY_PARTS_MAX);
  inRange(section, "end of the last leaf", leafStarts[leaves], receivers, receivers);
  // Each level of the tree holds every leaf once at most, so that reading all patches stays cheap.
  const ofPatches = patches.leafCount.reduce((sum, count) => sum + count, 0);
  inRange(section, "leaves of all patches together", ofPatches, 0, PATCH_LEVELS_MAX * leaves);
  const halves = new Uint32Array(patches.key.buffer);
  for (let index = 0; index < patches.length; index++) {
    const high = halves[2 * index + 1];
    const [first, count] = [patches.firstLeaf[index], patches.leafCount[index]];
    inRange(section, "level in a patch's key", high >>> 28, 0, LEVEL_MAX);
    inRange(section, "direction in a patch's key", (high >>> 23) & 0x1f, 0, DIRECTION_MAX);
    inRange(section, "leaves of a patch", count, 1, leaves);
    inRange(section, "first leaf", first, 0, leaves - count);
  }
  block.forEach((index) => inRange(section, "block index + 1", index + 1, 1, blocks.length));
}
