// Light of the clusters that have come; receivers of the overview stand for all others. Twin of client/src/kinds/prt/stream.rs.

import { assembleLight } from "./bake.js";
import { Inconsistent } from "./inconsistent.js";

// Arrays of a cluster's receivers, and how many numbers each has of one.
const ARRAYS = {
  block: 1,
  texel: 2,
  positionM: 3,
  normal: 3,
  albedo: 3,
  emission: 3,
  links: 1,
  coverage: 1,
  edge: 1,
};

/**
 * The light of some of a bake's clusters, `present` being decoded clusters by their number in the manifest, as a Map. With all
 * of them, `isWhole`, it is that of the whole bake.
 */
export function lightOfPrefix(scene, patchSet, overview, present, isWhole) {
  const clusters = [...present.keys()].sort((a, b) => a - b).map((index) => present.get(index));
  if (isWhole) {
    return assembleLight(scene, clusters, patchSet);
  }
  if (overview.some(({ near }) => near.length > 0)) {
    throw new Inconsistent("overview", "has near hits, which clusters of an overview have not");
  }
  const there = new Map();
  for (const { receivers } of clusters) {
    eachName(receivers, (key, texel) => {
      if (!there.has(key)) there.set(key, new Set());
      there.get(key).add(texel);
    });
  }
  const isAbsent = (key, texel) => !there.get(key)?.has(texel);
  const rest = overview.map((cluster) => only(cluster, isAbsent)).filter((cluster) => cluster !== null);
  return assembleLight(scene, [...clusters, ...rest], patchSet, false);
}

/** Calls `visit` with the key of each receiver's block and a number of its texel. */
function eachName({ blocks, block, texel }, visit) {
  block.forEach((index, receiver) => visit(blocks[index], texel[2 * receiver] * 2 ** 16 + texel[2 * receiver + 1]));
}

/** A cluster of an overview with the receivers alone that are wanted; null if none is. */
function only(cluster, isWanted) {
  const { receivers, factors, emitters } = cluster;
  const rows = [];
  let row = 0;
  eachName(receivers, (key, texel) => {
    if (isWanted(key, texel)) rows.push(row);
    row++;
  });
  if (rows.length === 0) return null;
  const kept = { ...receivers, length: rows.length };
  for (const [name, each] of Object.entries(ARRAYS)) {
    kept[name] = rowsOf(receivers[name], each, rows);
  }
  return {
    ...cluster,
    receivers: kept,
    factors: { ...factors, u: rowsOf(factors.u, factors.rank, rows) },
    emitters: emitters.map(({ emitter, irradiance }) => ({ emitter, irradiance: rowsOf(irradiance, 3, rows) })),
    // None has any, and their table would be of the receivers that are gone.
    near: { ...cluster.near, count: new Uint8Array(0), weight: new Float32Array(0) },
  };
}

/** Some rows of an array of `each` numbers a row. */
function rowsOf(values, each, rows) {
  const kept = new values.constructor(each * rows.length);
  rows.forEach((row, at) => kept.set(values.subarray(each * row, each * (row + 1)), each * at));
  return kept;
}
