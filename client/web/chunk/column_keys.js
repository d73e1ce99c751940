// Sets of column keys. Those of patches and parts of the sky are a walk through the cells that hold patches, level by level; others
// stand as they are.
//
// The place of a cell within its level is one number, direction · 2⁴⁵ + y · 2³⁰ + z · 2¹⁵ + x, each coordinate plus 2¹⁴: 48 bits.

import { allAscending, inRange } from "./error.js";
import { takeDeltas, takeU32s } from "./ints.js";
import { differenceOf, keyAt, skyKey, skyPartOf } from "./patch_key.js";

const PLAIN = 0;
const WALK = 1;
const WALK_OF_DIFFERENCES = 2;
const LEVEL_MAX = 14;
const DIRECTIONS = 6;
/** Cells of an axis lie in `−CELL_END..CELL_END`. */
const CELL_END = 2 ** 14;
const ORDINAL_MAX = 1023;
/** Code of a cell whose patches are listed. */
const LISTED = 3;
/** Units of an axis in a place. */
const AXIS_UNITS = [1, 2 ** 30, 2 ** 15];
const DIRECTION_UNIT = 2 ** 45;

/** Most raw bytes that `count` keys take. */
export function keysBytesMax(count) {
  return 1 + 8 * count;
}

/** Reads `count` keys, each larger than the one before, as a BigUint64Array. */
export function ascendingKeys(reader, what, count) {
  const keys = reader.u64s(what, count);
  allAscending(reader.section, what, keys);
  return keys;
}

/** Reads `count` keys of columns, ascending, as a BigUint64Array; the caller has checked `count`. */
export function takeKeys(reader, count) {
  const mode = inRange(reader.section, "mode of keys", reader.u8("mode of keys"), PLAIN, WALK_OF_DIFFERENCES);
  if (mode === PLAIN) return ascendingKeys(reader, "column key", count);
  const named = takeWalk(reader, count);
  return mode === WALK ? named : takeDifferences(reader, named);
}

/** Keys of columns that read `named`, or differences where the bit of it says so. */
function takeDifferences(reader, named) {
  const { section } = reader;
  const bits = reader.take("bits of differences", Math.ceil(named.length / 8));
  const keys = BigUint64Array.from(named, (key, index) => {
    const bit = (bits[index >> 3] >> (index & 7)) & 1;
    inRange(section, "bit of a difference", bit, 0, skyPartOf(key) === null ? 1 : 0);
    return bit === 1 ? differenceOf(key) : key;
  });
  const spare = bits.length === 0 ? 0 : bits[bits.length - 1] >> (1 + ((named.length - 1) % 8));
  inRange(section, "bits past the last key", spare, 0, 0);
  return keys.sort();
}

/** Numbers of which these are the distances, each from the one before less one; throws on numbers above `max`. */
function ascendingOf(section, what, gaps, max) {
  let next = 0;
  return Array.from(gaps, (gap) => {
    const number = inRange(section, what, next + gap, 0, max);
    next = number + 1;
    return number;
  });
}

/** Reads a walk to `count` keys: patches of all visited cells, and as many sky parts as are left. */
function takeWalk(reader, count) {
  const { section } = reader;
  const { keys, listed } = takeSingle(reader, takeCells(reader, count));
  const more = takeU32s(reader, "patches of a cell", listed.length);
  const inLists = more.reduce((sum, of) => sum + of + 1, 0);
  inRange(section, "patches", keys.length, 0, count);
  const left = count - keys.length;
  inRange(section, "listed patches", inLists, 0, left);
  const lists = takeU32s(reader, "number of a patch", inLists);
  let at = 0;
  listed.forEach(({ level, place }, index) => {
    const list = lists.subarray(at, (at += more[index] + 1));
    const ordinals = ascendingOf(section, "number of a patch", list, ORDINAL_MAX);
    ordinals.forEach((ordinal) => keys.push(keyAt(level, place, ordinal)));
  });
  const gaps = takeU32s(reader, "part of the sky", left - inLists);
  ascendingOf(section, "part of the sky", gaps, 0xffff_ffff).forEach((part) => keys.push(skyKey(part)));
  return BigUint64Array.from(keys).sort();
}

/** Reads the visited cells, from the highest level down: `{level, place, subCells}`, a bit of each visited sub-cell. */
function takeCells(reader, count) {
  const { section } = reader;
  const visited = [];
  let [level, places] = takeHighest(reader, count);
  for (; level > 0 && places.length > 0; level--) {
    const bits = reader.take("sub-cells", places.length);
    const below = bits.reduce((sum, of) => sum + bitsIn(of), 0);
    inRange(section, "cells of a level", below, 0, count);
    const next = new Float64Array(below);
    let at = 0;
    places.forEach((place, index) => {
      if (bits[index] !== 0) checkDivisible(section, place);
      for (let number = 0; number < 8; number++) {
        if ((bits[index] >> number) & 1) next[at++] = subCell(place, number);
      }
      visited.push({ level, place, subCells: bits[index] });
    });
    places = next.sort();
  }
  places.forEach((place) => visited.push({ level: 0, place, subCells: 0 }));
  return visited;
}

/** Reads the cells of the highest level: the level, and their places, ascending. */
function takeHighest(reader, count) {
  const { section } = reader;
  const level = inRange(section, "highest level", reader.u8("highest level"), 0, LEVEL_MAX);
  const ofDirection = takeU32s(reader, "cells of a direction", DIRECTIONS);
  const total = ofDirection.reduce((sum, cells) => sum + cells, 0);
  inRange(section, "cells of the highest level", total, 0, count);
  const axes = [0, 1, 2].map(() => takeDeltas(reader, "place of a cell", total, -CELL_END, CELL_END - 1));
  const places = new Float64Array(total);
  let at = 0;
  ofDirection.forEach((cells, direction) => {
    for (let index = 0; index < cells; index++, at++) {
      const units = (axis) => (axes[axis][at] + CELL_END) * AXIS_UNITS[axis];
      places[at] = direction * DIRECTION_UNIT + units(0) + units(1) + units(2);
    }
  });
  allAscending(section, "cell", places);
  return [level, places];
}

/** Coordinate of a place plus 2¹⁴. */
function coordinate(place, axis) {
  return Math.floor(place / AXIS_UNITS[axis]) % 2 ** 15;
}

/** Throws unless the sub-cells of a cell lie on their lattice. */
function checkDivisible(section, place) {
  const half = CELL_END / 2;
  for (let axis = 0; axis < 3; axis++) {
    inRange(section, "place of a divided cell + 2¹⁴", coordinate(place, axis), half, 3 * half - 1);
  }
}

/** Place of sub-cell `number`, 0…7. Its highest bit is that of the direction's axis, then those of the axes after it. */
function subCell(place, number) {
  const direction = Math.floor(place / DIRECTION_UNIT);
  const along = direction >> 1;
  let at = direction * DIRECTION_UNIT;
  for (let turn = 0; turn < 3; turn++) {
    const axis = (along + turn) % 3;
    const bit = (number >> (2 - turn)) & 1;
    at += (2 * coordinate(place, axis) - CELL_END + bit) * AXIS_UNITS[axis];
  }
  return at;
}

/** Reads the codes of `cells`: keys of cells with one patch, and cells whose patches are listed. */
function takeSingle(reader, cells) {
  const inner = cells.filter(({ subCells }) => subCells !== 0).length;
  const codes = [takeCodes(reader, cells.length - inner), takeCodes(reader, inner)];
  const at = [0, 0];
  const [keys, listed] = [[], []];
  for (const cell of cells) {
    const isInner = cell.subCells !== 0 ? 1 : 0;
    const index = at[isInner]++;
    const code = (codes[isInner][index >> 2] >> (2 * (index & 3))) & LISTED;
    if (code === LISTED) listed.push(cell);
    else if (code >= isInner) keys.push(keyAt(cell.level, cell.place, code - isInner));
  }
  return { keys, listed };
}

/** Bytes of `count` codes, four in each. */
function takeCodes(reader, count) {
  return reader.take("codes of cells", Math.ceil(count / 4));
}

function bitsIn(byte) {
  let count = 0;
  for (let rest = byte; rest !== 0; rest &= rest - 1) count++;
  return count;
}
