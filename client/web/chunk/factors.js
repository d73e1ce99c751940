// Factors U and ΣVᵀ of rows, from whole-number codes, coarse to fine.

import { Reader } from "./bytes.js";
import { CellReader } from "./cells.js";
import { keysBytesMax, takeKeys } from "./column_keys.js";
import { ColumnOrder } from "./column_order.js";
import { scalesBytesMax, takeScales } from "./column_scale.js";
import { allNumbers, inRange } from "./error.js";
import { bandGroups, coefficientsOf, rankGroups, ranksOf } from "./layers.js";

/** Rows per cell of U. */
const U_CELL = 48;
/** Columns per cell of ΣVᵀ where each group of columns has but one. */
const VT_CELL = 48;
/** Codes of a column of U are stored as differences from guesses; else as they are. */
const GUESSED = 1;
/** Largest step: no code times it overflows. */
const STEP_MAX = Math.fround(1e28);

/** The number of a code, in f32. */
function valueOf(code, step) {
  return Math.fround(Math.fround(code) * step);
}

/** Parts of `layer`: by rank group, first ΣVᵀ by band group, then U from coarse to fine. */
function partsOf(shape, layer) {
  const parts = [];
  for (let ranks = 0; ranks < rankGroups(layer.rank); ranks++) {
    for (let bands = 0; bands < bandGroups(layer.bands); bands++) parts.push({ ofVt: true, ranks, bands });
    for (const level of shape.levelsIn(layer)) parts.push({ ofVt: false, ranks, level });
  }
  return parts;
}

/** Parts that `layer` adds to `before`. */
function newParts(shape, before, layer) {
  const known = before === null ? [] : partsOf(shape, before);
  const isSame = (a, b) =>
    a.ofVt === b.ofVt && a.ranks === b.ranks && a.bands === b.bands && a.level === b.level;
  return partsOf(shape, layer).filter((part) => !known.some((other) => isSame(part, other)));
}

/** Columns of each cell of one row of ΣVᵀ with bands up to `bands`, as `[start, end]`. */
function vtCells(shape, bands, group) {
  const groups = shape.columnGroups();
  const cells = [];
  if (shape.bands === 0) {
    for (let first = 0; first < groups; first += VT_CELL) cells.push([first, Math.min(groups, first + VT_CELL)]);
    return cells;
  }
  const coefficients = (bands + 1) * (bands + 1);
  const [start, end] = coefficientsOf(group, shape.bands);
  for (let index = 0; index < groups; index++) {
    cells.push([index * coefficients + start, index * coefficients + end]);
  }
  return cells;
}

/** Calls `visit` with the length of each cell of `parts`, in order. */
function eachCellLength(shape, parts, visit) {
  for (const part of parts) {
    const [firstRank, endRank] = ranksOf(part.ranks, shape.rank);
    const lengths = part.ofVt
      ? vtCells(shape, shape.bands, part.bands).map(([start, end]) => end - start)
      : rowCells(shape.counts[part.level]);
    for (let rank = firstRank; rank < endRank; rank++) lengths.forEach(visit);
  }
}

function rowCells(rows) {
  const lengths = [];
  for (let first = 0; first < rows; first += U_CELL) lengths.push(Math.min(U_CELL, rows - first));
  return lengths;
}

/** Columns of U among `parts`: each has a byte that says how its codes are stored. */
function uColumns(shape, parts) {
  return parts
    .filter((part) => !part.ofVt)
    .map((part) => ranksOf(part.ranks, shape.rank))
    .reduce((sum, [first, end]) => sum + end - first, 0);
}

/** Most raw bytes of keys, scales and steps. */
export function baseBytesMax(shape) {
  return keysBytesMax(shape.keys) + scalesBytesMax(shape.keys) + 8 * shape.rank;
}

/** Memory that a decoded layer's factors and keys take, about. */
export function layerDecodedBytes(shape, layer) {
  return 4 * layer.rank * (shape.receiversIn(layer.level) + shape.columns(layer.bands)) + 8 * shape.keys;
}

/** Most raw bytes of a layer's two sections of factors: high parts, low parts. */
export function layerBytesMax(shape, before, layer) {
  const parts = newParts(shape, before, layer);
  let [cells, numbers] = [0, 0];
  eachCellLength(shape, parts, (length) => {
    cells++;
    numbers += length;
  });
  return [uColumns(shape, parts) + cells + numbers, 3 * numbers + 1];
}

/** Factors that fill up layer by layer, up to `layer`. */
export class FactorDecoder {
  constructor(shape, layer) {
    const [rank, rows] = [layer.rank, shape.receiversIn(layer.level)];
    this.shape = shape;
    this.factors = {
      keys: new BigUint64Array(0),
      bands: layer.bands,
      sky: shape.sky,
      rank,
      u: new Float32Array(rows * rank),
      vt: new Float32Array(rank * shape.columns(layer.bands)),
      steps: { u: new Float32Array(0), vt: new Float32Array(0), scale: new Float32Array(0) },
    };
    // Codes of U that later layers guess from, one array per rank, in stored order of rows.
    this.uCodes = Array.from({ length: rank }, () => new Int32Array(rows));
    // Of the next rank of ΣVᵀ, where keys have one column each.
    this.order = null;
  }

  /** Reads keys, scales and steps. */
  base(reader) {
    const { shape, factors } = this;
    factors.keys = takeKeys(reader, shape.keys);
    if (shape.hasScales()) {
      factors.steps.scale = takeScales(reader, factors.keys);
      this.order = new ColumnOrder(shape.keys);
    }
    const takeSteps = (what) => {
      const steps = reader.f32s(what, shape.rank);
      allNumbers("base", what, steps, "0..=1e28", (step) => step >= 0 && step <= STEP_MAX);
      return steps;
    };
    const [u, vt] = [takeSteps("steps of U"), takeSteps("steps of ΣVᵀ")];
    const largest = factors.steps.scale.reduce((most, scale) => Math.max(most, scale), 1);
    const isSmall = (step) => Math.fround(step * largest) <= STEP_MAX;
    allNumbers("base", "step of ΣVᵀ at the largest scale", vt, "0..=1e28", isSmall);
    // Those of the layer alone.
    factors.steps.u = u.slice(0, factors.rank);
    factors.steps.vt = vt.slice(0, factors.rank);
  }

  /** Reads what `layer` adds to `before` from its two sections. */
  layer([highBytes, lowBytes], before, layer, predictor) {
    const { shape } = this;
    const parts = newParts(shape, before, layer);
    const [high, low] = [new Reader("factors", highBytes), new Reader("low parts", lowBytes)];
    const modes = high.take("modes", uColumns(shape, parts));
    const cells = new CellReader(high, low, (visit) => eachCellLength(shape, parts, visit));
    high.end();
    low.end();
    let mode = 0;
    for (const part of parts) {
      if (part.ofVt) {
        this.readVt(part, cells);
        continue;
      }
      const [firstRank, endRank] = ranksOf(part.ranks, shape.rank);
      for (let rank = firstRank; rank < endRank; rank++) {
        const isGuessed = inRange("factors", "mode of U", modes[mode++], 0, GUESSED) === GUESSED;
        this.readU(part.level, rank, isGuessed ? predictor : null, cells);
      }
    }
  }

  readVt({ ranks, bands }, cells) {
    const { shape, factors, order } = this;
    const columns = shape.columns(factors.bands);
    const ofRow = vtCells(shape, factors.bands, bands);
    const codes = new Int32Array(columns);
    const byKey = new Int32Array(order === null ? 0 : columns);
    const [firstRank, endRank] = ranksOf(ranks, shape.rank);
    for (let rank = firstRank; rank < endRank; rank++) {
      const row = factors.vt.subarray(rank * columns, (rank + 1) * columns);
      const step = factors.steps.vt[rank];
      for (const [start, end] of ofRow) {
        cells.next(end - start, codes, start);
        for (let at = start; at < end; at++) {
          const column = order === null ? at : order.columns[at];
          // Scales are 1 where there are none.
          row[column] = valueOf(codes[at], step) * (factors.steps.scale[column] ?? 1);
          byKey[column] = codes[at];
        }
      }
      order?.advance(byKey);
    }
  }

  readU(level, rank, predictor, cells) {
    const { shape, factors } = this;
    const [start, end] = shape.rowsOf(level);
    const codes = this.uCodes[rank];
    for (let row = start; row < end; row += U_CELL) cells.next(Math.min(U_CELL, end - row), codes, row);
    predictor?.restore(start, end, codes);
    const step = factors.steps.u[rank];
    for (let row = start; row < end; row++) factors.u[row * factors.rank + rank] = valueOf(codes[row], step);
  }
}
