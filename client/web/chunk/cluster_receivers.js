// Receivers of a cluster chunk, level by level: places, materials, irradiance of emitters.

import { ChunkError, allNumbers, inRange } from "./error.js";
import { bytesMax, takeDeltas, takeF32Planes, takeI32s, takeU32s } from "./ints.js";
import { albedoOf, irradianceOf, positionOf, putNormal } from "./numbers.js";

/** Most albedos in a palette. */
export const PALETTE_MAX = 256;
/** All bits of a receiver's links. */
const LINKS_MAX = 15;
const ALBEDO_COLUMN = 5;
/** Least and most of the columns of codes that are guessed: position x, y, z; normal u, v; albedo R, G, B. */
const COLUMN_RANGES = [
  [0, 65_535], [0, 65_535], [0, 65_535], [-32_767, 32_767], [-32_767, 32_767], [0, 255], [0, 255], [0, 255],
];

/** Most raw bytes of `count` receivers of a level. */
export function receiversBytesMax(count, blocks, emitters) {
  return bytesMax(blocks) + 16 * bytesMax(count) + 4 * emitters * bytesMax(count);
}

/** Arrays for `count` receivers: their shape is that of `cluster.receivers` in `cluster.js`. */
export function emptyReceivers(count) {
  return {
    length: 0,
    blocks: new BigUint64Array(0),
    block: new Uint16Array(count),
    texel: new Uint16Array(2 * count),
    positionM: new Float32Array(3 * count),
    normal: new Float32Array(3 * count),
    albedo: new Float32Array(3 * count),
    emission: new Float32Array(3 * count),
    links: new Uint8Array(count),
    coverage: new Uint16Array(count),
    edge: new Uint16Array(count),
  };
}

/** Level of a receiver: trailing zero bits common to its texel coordinates, at most `levels − 1`. */
export function levelOfTexel(x, y, levels) {
  const both = x | y;
  return Math.min(both === 0 ? 32 : 31 - Math.clz32(both & -both), levels - 1);
}

/** Codes that receivers of finer levels are guessed from, and what all levels share. */
export class ReceiverCodec {
  constructor(boundsM, levels, count) {
    this.boundsM = boundsM;
    this.levels = levels;
    /** Albedos, three numbers each; empty when albedos are 8-bit codes. */
    this.palette = new Float32Array(0);
    this.columns = COLUMN_RANGES.map(() => new Int32Array(count));
  }

  /** Reads `count` receivers of `level` and appends them to `receivers`; the predictor learns of them. */
  read(reader, receivers, count, level, predictor) {
    const start = receivers.length;
    const end = start + count;
    readTexels(reader, receivers, count, level, this.levels);
    receivers.length = end;
    predictor.extend(receivers, start, end, level);
    const guessed = this.palette.length === 0 ? COLUMN_RANGES.length : ALBEDO_COLUMN;
    for (let column = 0; column < guessed; column++) this.readColumn(reader, column, start, count, predictor);
    this.decodeColumns(receivers, start, end);
    this.readPaletteAlbedo(reader, receivers, start, count);
    readEmission(reader, receivers, start, count);
    const ranged = (what, max) => {
      const values = takeU32s(reader, what, count);
      values.forEach((value) => inRange("receivers", what, value, 0, max));
      return values;
    };
    receivers.links.set(ranged("links", LINKS_MAX), start);
    receivers.coverage.set(ranged("coverage", 0xffff).map((uncovered) => 0xffff ^ uncovered), start);
    receivers.edge.set(ranged("edge", 0xffff), start);
  }

  readColumn(reader, column, start, count, predictor) {
    const codes = this.columns[column];
    codes.set(takeI32s(reader, "attribute", count), start);
    predictor.restore(start, start + count, codes);
    const [min, max] = COLUMN_RANGES[column];
    for (let row = start; row < start + count; row++) {
      if (codes[row] >= min && codes[row] <= max) continue;
      const { section } = reader;
      const what = "code of a position, normal or albedo";
      const message = `${section}: ${what} is ${Math.abs(codes[row])}, allowed is 0..=${max}`;
      throw new ChunkError("out_of_range", message, { section, what });
    }
  }

  decodeColumns(receivers, start, end) {
    const { boundsM, columns } = this;
    for (let row = start; row < end; row++) {
      for (let axis = 0; axis < 3; axis++) {
        const position = positionOf(columns[axis][row], boundsM[axis], boundsM[3 + axis]);
        receivers.positionM[3 * row + axis] = position;
      }
      putNormal(receivers.normal, 3 * row, columns[3][row], columns[4][row]);
      if (this.palette.length > 0) continue;
      for (let channel = 0; channel < 3; channel++) {
        receivers.albedo[3 * row + channel] = albedoOf(columns[ALBEDO_COLUMN + channel][row]);
      }
    }
  }

  readPaletteAlbedo(reader, receivers, start, count) {
    const { palette } = this;
    if (palette.length === 0) return;
    const last = palette.length / 3 - 1;
    takeU32s(reader, "albedo", count).forEach((index, row) => {
      inRange(reader.section, "albedo", index, 0, last);
      receivers.albedo.set(palette.subarray(3 * index, 3 * index + 3), 3 * (start + row));
    });
  }
}

/** The bits of x, or of y of `morton >> 1`, from a Morton code. */
function gather(morton) {
  let bits = morton & 0x5555_5555;
  bits = (bits | (bits >>> 1)) & 0x3333_3333;
  bits = (bits | (bits >>> 2)) & 0x0f0f_0f0f;
  bits = (bits | (bits >>> 4)) & 0x00ff_00ff;
  return (bits | (bits >>> 8)) & 0xffff;
}

function readTexels(reader, receivers, count, level, levels) {
  const { section } = reader;
  const counts = takeU32s(reader, "receivers per block", receivers.blocks.length);
  const total = counts.reduce((sum, of) => sum + of, 0);
  inRange(section, "receivers of all blocks", total, count, count);
  const steps = takeU32s(reader, "texel", count);
  const last = 0xffff_ffff >>> (2 * level);
  let row = receivers.length;
  let at = 0;
  counts.forEach((inBlock, block) => {
    let next = 0;
    for (const end = at + inBlock; at < end; at++, row++) {
      const code = inRange(section, "texel", next + steps[at], 0, last);
      const morton = (code << (2 * level)) >>> 0;
      const [x, y] = [gather(morton), gather(morton >>> 1)];
      inRange(section, "texel's level", levelOfTexel(x, y, levels), level, level);
      receivers.texel[2 * row] = x;
      receivers.texel[2 * row + 1] = y;
      receivers.block[row] = block;
      next = code + 1;
    }
  });
}

/** Rows of a mask of zeros and ones that are set. */
function takeMask(reader, what, count) {
  const rows = [];
  takeU32s(reader, what, count).forEach((bit, row) => {
    if (inRange(reader.section, what, bit, 0, 1) === 1) rows.push(row);
  });
  return rows;
}

function readEmission(reader, receivers, start, count) {
  const emitting = takeMask(reader, "emission mask", count);
  for (let channel = 0; channel < 3; channel++) {
    const values = takeF32Planes(reader, "emission", emitting.length);
    allNumbers(reader.section, "emission", values, "0 or more", (value) => value >= 0);
    emitting.forEach((row, index) => (receivers.emission[3 * (start + row) + channel] = values[index]));
  }
}

/** Reads the irradiance of an emitter at `count` receivers from `start` on. */
export function readIrradiance(reader, irradiance, start, count) {
  const what = "irradiance";
  const lit = takeMask(reader, "irradiance mask", count);
  const red = takeDeltas(reader, what, lit.length, 0, 65_535);
  lit.forEach((row, index) => (irradiance[3 * (start + row)] = irradianceOf(red[index])));
  for (let channel = 1; channel < 3; channel++) {
    const first = reader.u32(what) | 0;
    const over = takeI32s(reader, what, lit.length);
    lit.forEach((row, index) => {
      const code = (((red[index] + first) | 0) + over[index]) >>> 0;
      inRange(reader.section, what, code, 0, 65_535);
      irradiance[3 * (start + row) + channel] = irradianceOf(code);
    });
  }
}
