// Near hits of all clusters, their texels resolved to slots; twin of proto/src/relight/near.rs.

import { NEAR_STEPS, NEAR_STEPS_STORED } from "../chunk/cluster_near.js";
import { Growing } from "./growing.js";
import { Inconsistent } from "./inconsistent.js";
import { allFinite, fround } from "./numbers.js";
import { NO_SLOT } from "./slots.js";

// Bit of a hit's light: it lies on a surface that no texel stands for, and has E_emit and E_ind of the receiver that meets it.
const OWN_SURFACE = 0x80000000;

/** Near hits of a bake. Hits on texels that no light reaches are left out: they are dark. */
export class NearTable {
  #rows = new Growing(Uint32Array);
  #hits = new Growing(Uint32Array);
  #own = new Growing(Float32Array);
  #known = new Map();

  constructor(contents, clusters, receivers, slots) {
    contents.forEach(({ near }, index) => {
      const { firstRow, rowCount } = clusters.clusters[index];
      try {
        check(near, rowCount);
        this.#push(near, firstRow, receivers, slots);
      } catch (error) {
        throw new Inconsistent(`cluster ${index}`, error.message);
      }
    });
    // Four words each, as shaders read them. Rows: slot, first hit, hits, bits of the weight.
    this.rows = this.#rows.finish();
    // Hits: bits of the place in metres, and the light.
    this.hits = this.#hits.finish();
    // Surfaces that no texel stands for: normal and albedo, four numbers each.
    this.own = this.#own.finish();
  }

  /** Adds the hits of a cluster whose receivers begin at slot `firstReceiver`. */
  #push(near, firstReceiver, receivers, slots) {
    const blocks = slots.blockIndices(near.blocks);
    const weightBits = new Uint32Array(Float32Array.from(near.weight).buffer);
    let hit = 0;
    for (let receiver = 0; receiver < near.count.length; receiver++) {
      const slot = firstReceiver + receiver;
      const first = this.#hits.length / 4;
      for (const end = hit + near.count[receiver]; hit < end; hit++) {
        this.#pushHit(near, hit, slot, blocks, receivers, slots);
      }
      const count = this.#hits.length / 4 - first;
      if (count > 0) {
        this.#rows.extend([slot, first, count, weightBits[receiver]]);
      }
    }
  }

  #pushHit({ surface, offset, reachM }, hit, slot, blocks, receivers, slots) {
    let light;
    let normal;
    if (surface.isOwn[hit] === 1) {
      normal = surface.normal.subarray(3 * hit, 3 * hit + 3);
      light = OWN_SURFACE + this.#ownSurface(normal, surface.albedo.subarray(3 * hit, 3 * hit + 3));
    } else {
      light = slots.standing(blocks[surface.block[hit]], surface.texel[2 * hit], surface.texel[2 * hit + 1]);
      if (light === NO_SLOT) {
        return;
      }
      normal = receivers.normal.subarray(4 * light, 4 * light + 3);
    }
    const place = new Float32Array(3);
    const stepM = fround(fround(reachM) / NEAR_STEPS);
    for (let axis = 0; axis < 3; axis++) {
      // Raised by a stored step, as rounding may have put it below its surface.
      const steps = fround(offset[3 * hit + axis] + fround(NEAR_STEPS_STORED * normal[axis]));
      place[axis] = receivers.positionM[4 * slot + axis] + fround(steps * stepM);
    }
    this.#hits.extend(new Uint32Array(place.buffer));
    this.#hits.push(light);
  }

  /** Number of a surface; faces of a few directions and colours are there once each. */
  #ownSurface(normal, albedo) {
    const key = [...normal, ...albedo].join();
    let own = this.#known.get(key);
    if (own === undefined) {
      own = this.#own.length / 8;
      this.#known.set(key, own);
      this.#own.extend([...normal, 0, ...albedo, 0]);
    }
    return own;
  }
}

/** Checks the hits of a cluster of so many receivers. */
function check({ count, weight, blocks, surface, offset, reachM, length }, receivers) {
  const hits = count.reduce((sum, of) => sum + of, 0);
  const isBlank = count.length === 0 && weight.length === 0;
  const byReceiver = isBlank || (count.length === receivers && weight.length === receivers);
  if (length !== hits || offset.length !== 3 * hits || !byReceiver) {
    throw new Error(`its near hits differ in length: ${hits}, ${length}, ${offset.length}`);
  }
  const isThere = surface.isOwn.every((isOwn, hit) => isOwn === 1 || surface.block[hit] < blocks.length);
  const isAlbedo = surface.albedo.every((albedo) => albedo >= 0 && albedo <= 1);
  const numbers = [[reachM], weight, surface.normal];
  if (!isThere || !isAlbedo || !numbers.every(allFinite)) {
    throw new Error("a near hit names no block, or one of its numbers is none");
  }
}
