// Clusters and their factors, and light straight from emitters; twin of proto/src/relight/clusters.rs.

import { Growing } from "./growing.js";
import { Inconsistent } from "./inconsistent.js";
import { allFinite, fround } from "./numbers.js";
import { GROUP, numberOf, packU, packVt, stepOf } from "./packed.js";

/** Highest rank of a cluster that is read. */
export const MAX_RANK = 256;

/** Clusters and their factors, whose columns read `columns`. */
export class ClusterTable {
  constructor(contents, columns) {
    this.clusters = [];
    this.bLen = 0;
    const joined = {
      u: new Growing(Uint32Array),
      vt: new Growing(Uint32Array),
      // Pairs as shaders read them: place in λ, bits of the scale.
      columns: new Growing(Uint32Array),
      steps: new Growing(Float32Array),
      // Level of each column; it falls within each class of columns.
      levels: new Growing(Uint8Array),
    };
    let firstRow = 0;
    contents.forEach(({ factors, receivers }, index) => {
      const rows = receivers.block.length;
      try {
        check(factors, rows, columns);
        this.#push(joined, factors, columns, firstRow, rows);
      } catch (error) {
        throw new Inconsistent(`cluster ${index}`, error.message);
      }
      firstRow += rows;
    });
    this.u = joined.u.finish();
    this.vt = joined.vt.finish();
    this.columns = joined.columns.finish();
    this.steps = joined.steps.finish();
    this.columnLevels = joined.levels.finish();
  }

  #push(joined, factors, columns, firstRow, rowCount) {
    const { rank } = factors;
    const columnCount = factors.keys.length;
    const { places, scales, levels } = columnsOf(factors, columns);
    const stepsOfU = Float32Array.from({ length: rank }, (_, i) => stepOf(factors.steps.u, i));
    const stepsOfVt = Float32Array.from({ length: rank }, (_, i) => stepOf(factors.steps.vt, i));
    const ofU = new Float32Array(rank * rowCount);
    for (let at = 0; at < ofU.length; at++) {
      ofU[at] = numberOf(factors.u[at], stepsOfU[at % rank], 1);
    }
    const ofVt = new Float32Array(rank * columnCount);
    for (let i = 0, at = 0; i < rank; i++) {
      for (let column = 0; column < columnCount; column++, at++) {
        ofVt[at] = numberOf(factors.vt[at], stepsOfVt[i], scales[column]);
      }
    }
    const u = packU(ofU, rank, rowCount);
    const vt = packVt(ofVt, levels, rank);
    const scaleBits = new Uint32Array(scales.buffer);
    const firstColumn = joined.columns.length / 2;
    for (const column of vt.order) {
      joined.columns.push(places[column]);
      joined.columns.push(scaleBits[column]);
      joined.levels.push(levels[column]);
    }
    const padded = Math.ceil(rank / GROUP) * GROUP;
    const steps = new Float32Array(padded);
    for (let i = 0; i < rank; i++) {
      steps[i] = fround(stepsOfU[i] * stepsOfVt[i]);
    }
    if (!allFinite(steps)) {
      throw new Error("its steps are too large");
    }
    this.clusters.push({
      firstRow,
      rowCount,
      firstColumn,
      columnCount,
      rank,
      firstB: this.bLen,
      u: { first: joined.u.length, ...u.packing },
      vt: { first: joined.vt.length, ...vt.packing },
    });
    joined.u.extend(u.words);
    joined.vt.extend(vt.words);
    joined.steps.extend(steps);
    this.bLen += padded;
  }
}

/** Places in λ, scales and levels of a cluster's columns. */
function columnsOf(factors, columns) {
  const count = factors.keys.length;
  const places = new Uint32Array(count);
  const scales = new Float32Array(count);
  const levels = new Uint8Array(count);
  for (let index = 0; index < count; index++) {
    const place = columns.index(factors.keys[index]);
    if (place < 0) {
      throw new Error(`column ${factors.keys[index].toString(16).padStart(16, "0")} is in no chunk`);
    }
    places[index] = place;
    scales[index] = factors.steps.scale[index] ?? 1;
    levels[index] = columns.level(factors.keys[index]);
  }
  return { places, scales, levels };
}

function check(factors, rows, columns) {
  if (factors.bands > columns.bands) {
    throw new Error(`has ${factors.bands} bands, the bake ${columns.bands}`);
  }
  if (factors.sky) {
    throw new Error("has columns of a sky that the bake lacks");
  }
  if (factors.rank > MAX_RANK) {
    throw new Error(`has rank ${factors.rank}, at most ${MAX_RANK}`);
  }
  const { rank } = factors;
  if (factors.u.length !== rows * rank || factors.vt.length !== factors.keys.length * rank) {
    throw new Error("its factors do not have the lengths that rank, rows and columns ask for");
  }
  if (!allFinite(factors.u) || !allFinite(factors.vt)) {
    throw new Error("a factor is not a finite number");
  }
}

/** Irradiance straight from emissive surfaces at all receivers. */
export class EmitterTable {
  constructor(contents, emitters) {
    this.parts = [];
    let firstRow = 0;
    contents.forEach((content, index) => {
      const rows = content.receivers.block.length;
      for (const { emitter, irradiance } of content.emitters) {
        if (irradiance.length !== 3 * rows || emitter >= emitters) {
          const problem = `its light from emitter ${emitter} has a wrong length or no emitter`;
          throw new Inconsistent(`cluster ${index}`, problem);
        }
        this.parts.push({ emitter, firstRow, irradiance });
      }
      firstRow += rows;
    });
  }

  /** Irradiance at `rows` receivers, W·m⁻², four numbers each; `scale` is one factor per emitter, 1 if absent. */
  irradiance(rows, scale) {
    const sum = new Float32Array(4 * rows);
    for (const { emitter, firstRow, irradiance } of this.parts) {
      const factor = fround(scale[emitter] ?? 1);
      for (let at = 0, to = 4 * firstRow; at < irradiance.length; at += 3, to += 4) {
        for (let channel = 0; channel < 3; channel++) {
          sum[to + channel] += fround(irradiance[at + channel] * factor);
        }
      }
    }
    return sum;
  }
}
