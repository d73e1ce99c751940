// Receivers by slot; twin of proto/src/relight/receivers.rs.

import { Inconsistent } from "./inconsistent.js";
import { allFinite } from "./numbers.js";

// Most receivers that a bake may have.
const MAX_RECEIVERS = 2 ** 26;

/** Receivers by slot. Vectors have four numbers, as adapters read them; the fourth is 0. */
export class ReceiverTable {
  /** Joins the receivers of clusters, one after the other, and enters them into `slots`. */
  constructor(clusters, slots) {
    const count = clusters.reduce((sum, { receivers }) => sum + receivers.block.length, 0);
    if (count > MAX_RECEIVERS) {
      throw new Inconsistent("clusters", `have ${count} receivers, at most ${MAX_RECEIVERS}`);
    }
    this.count = 0;
    this.positionM = new Float32Array(4 * count);
    this.normal = new Float32Array(4 * count);
    this.albedo = new Float32Array(4 * count);
    this.links = new Uint8Array(count);
    this.coverage = new Uint16Array(count);
    this.edge = new Uint16Array(count);
    // Number of each one's block of the lightmap, in the manifest's order.
    this.block = new Uint32Array(count);
    clusters.forEach(({ receivers }, index) => {
      try {
        this.#push(receivers, slots);
      } catch (error) {
        throw new Inconsistent(`cluster ${index}`, error.message);
      }
    });
  }

  #push(receivers, slots) {
    checkLengths(receivers);
    const blocks = slots.blockIndices(receivers.blocks);
    const count = receivers.block.length;
    for (let index = 0; index < count; index++) {
      const block = blocks[receivers.block[index]];
      if (block === undefined) {
        throw new Error(`receiver ${index} names no block`);
      }
      try {
        slots.enter(block, receivers.texel[2 * index], receivers.texel[2 * index + 1], this.count + index);
      } catch (error) {
        throw new Error(`receiver ${index} ${error.message}`);
      }
      this.block[this.count + index] = block;
    }
    for (const name of ["positionM", "normal", "albedo"]) {
      if (!allFinite(receivers[name])) {
        throw new Error("a receiver has a number that is not finite");
      }
      this.#spread(this[name], receivers[name]);
    }
    if (receivers.albedo.some((albedo) => albedo < 0 || albedo > 1)) {
      throw new Error("a receiver has an albedo outside 0..=1");
    }
    this.links.set(receivers.links, this.count);
    this.coverage.set(receivers.coverage, this.count);
    this.edge.set(receivers.edge, this.count);
    this.count += count;
  }

  /** Vectors of three numbers → of four, from the next slot on. */
  #spread(to, from) {
    for (let at = 0, slot = 4 * this.count; at < from.length; at += 3, slot += 4) {
      to[slot] = from[at];
      to[slot + 1] = from[at + 1];
      to[slot + 2] = from[at + 2];
    }
  }
}

function checkLengths(receivers) {
  const count = receivers.block.length;
  const lengths = {
    texel: 2,
    positionM: 3,
    normal: 3,
    albedo: 3,
    links: 1,
    coverage: 1,
    edge: 1,
  };
  for (const [name, each] of Object.entries(lengths)) {
    if (receivers[name].length !== each * count) {
      throw new Error(`its receiver arrays differ in length: ${count}, ${name} ${receivers[name].length}`);
    }
  }
}
