// Buffer views compressed by meshoptimizer, EXT_meshopt_compression and KHR_meshopt_compression; twin of worker/src/scene/meshopt.rs.
//
// Vertices:  header, blocks of up to 256 elements, and at the end the element that the first one is a difference to. A block has
//            each byte of its elements apart, in groups of 16 that take 0, 1, 2, 4 or 8 bits a byte, with larger ones behind them.
// Triangles: header, a code for each, which names edges and vertices of those before, then numbers that are none of these, and a
//            table of 16 codes.
// Indices:   header, and differences to one of two indices before.
//
// Bytes are not trusted: every place is checked before it is read, and sizes before room is made for them.

import { whole } from "./document.js";
import { broken } from "./error.js";
import { filtered } from "./meshopt_filters.js";

// Names of the extension: one format, of which the second has more filters.
const EXTENSIONS = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

// Most decoded bytes for one compressed byte, by the densest form that a block of vertices can have.
const EXPANSION_MAX = 1024;
const HEADERS = { ATTRIBUTES: 0xa0, TRIANGLES: 0xe0, INDICES: 0xd0 };
const VERSION_MAX = 1;
// Elements of a group, and most of a block, which has so many bytes.
const GROUP = 16;
const BLOCK_MAX = 256;
const BLOCK_BYTES = 8192;
// Least bytes behind a place where a group may begin, and those behind the blocks by version.
const GROUP_LEFT = 24;
const TAIL_MIN = [32, 24];
// Bytes behind triangles, a table, and behind indices.
const CODES = 16;
const INDICES_TAIL = 4;
// Bits of a byte of a group by version and control.
const BITS = [[0, 2, 4, 8], [0, 1, 2, 4], [1, 2, 4, 8]];

/** Whether a buffer stands in for compressed views: it need not hold any bytes. */
export function isStandIn(buffer) {
  return EXTENSIONS.some((name) => buffer.extensions?.[name] !== undefined);
}

/** The extension of a buffer view; null where it has none. */
export function compressionOf(view) {
  const name = EXTENSIONS.find((name) => view.extensions?.[name] !== undefined);
  return name === undefined ? null : view.extensions[name];
}

/** Reads the extension of a view, `{buffer, byteOffset, byteLength, byteStride, count, mode, filter}`. Errs for sizes that it does not allow. */
export function readCompression(stated, place) {
  const [byteOffset, byteLength] = [whole(stated, "byteOffset", place, 0), whole(stated, "byteLength", place)];
  const [byteStride, count] = [whole(stated, "byteStride", place), whole(stated, "count", place)];
  const { buffer, mode, filter = "NONE" } = stated;
  const isText = [mode, filter].every((name) => typeof name === "string");
  const isVertices = mode === "ATTRIBUTES";
  const strides = {
    NONE: () => true,
    OCTAHEDRAL: () => byteStride === 4 || byteStride === 8,
    COLOR: () => byteStride === 4 || byteStride === 8,
    QUATERNION: () => byteStride === 8,
    EXPONENTIAL: () => true,
  };
  const fits = isVertices ? byteStride % 4 === 0 && byteStride >= 4 && byteStride <= 256 : byteStride === 2 || byteStride === 4;
  const isFilter = Object.hasOwn(strides, filter) && (filter === "NONE" || isVertices) && strides[filter]();
  if (!isText || !Object.hasOwn(HEADERS, mode) || !fits || !isFilter) {
    throw broken(place(), "its stride, mode and filter do not fit each other");
  }
  if (mode === "TRIANGLES" && count % 3 !== 0) throw broken(place(), "its triangles are not whole");
  if (Math.floor((count * byteStride) / EXPANSION_MAX) > byteLength) {
    throw broken(place(), `${byteLength} bytes cannot hold its ${count} elements`);
  }
  return { buffer, byteOffset, byteLength, byteStride, count, mode, filter };
}

/** Bytes of a view from its compressed ones; null where these are none. */
export function decompressed(bytes, { mode, filter, count, byteStride: stride }) {
  const version = bytes.length > 0 ? bytes[0] - HEADERS[mode] : -1;
  if (version < 0 || version > VERSION_MAX) return null;
  if (mode === "ATTRIBUTES") {
    const elements = elementsOf(bytes, version, count, stride);
    return elements && filtered(elements, filter, stride);
  }
  // A code for each triangle and a table, or at least a byte for each index.
  if (bytes.length < (mode === "TRIANGLES" ? 1 + count / 3 + CODES : 1 + count + INDICES_TAIL)) return null;
  const indices = new (stride === 2 ? Uint16Array : Uint32Array)(count);
  const isWhole = mode === "TRIANGLES" ? readTriangles(bytes, version, indices) : readIndices(bytes, indices);
  return isWhole ? new Uint8Array(indices.buffer) : null;
}

/** The number whose sign is its lowest bit. */
function signed(value) {
  return (value >>> 1) ^ -(value & 1);
}

function elementsOf(bytes, version, count, stride) {
  const own = stride + (version === 0 ? 0 : stride / 4);
  const tail = Math.max(own, TAIL_MIN[version]);
  if (bytes.length < 1 + tail) return null;
  const last = bytes.slice(bytes.length - own, bytes.length - own + stride);
  const channels = version === 0 ? null : bytes.subarray(bytes.length - own + stride);
  const elements = new Uint8Array(count * stride);
  const most = Math.min(Math.floor(BLOCK_BYTES / stride) & ~(GROUP - 1), BLOCK_MAX);
  const planes = Array.from({ length: 4 }, () => new Uint8Array(BLOCK_MAX));
  let at = 1;
  for (let first = 0; first < count; first += most) {
    const size = Math.min(most, count - first);
    const controls = at;
    if (version > 0) at += stride / 4;
    if (at > bytes.length) return null;
    for (let byte = 0; byte < stride; byte += 4) {
      const control = version === 0 ? 0 : bytes[controls + byte / 4];
      for (const [place, plane] of planes.entries()) {
        at = readPlane(bytes, at, plane, size, version, (control >> (2 * place)) & 3);
        if (at === null) return null;
      }
      const channel = channels === null ? 0 : channels[byte / 4];
      const block = { elements, first, size, stride, byte };
      if ((channel & 3) === 0) addBytes(planes, block, last);
      else if ((channel & 3) === 1) addShorts(planes, block, last);
      else if ((channel & 3) === 2) turnWords(planes, block, last, channel >> 4);
      else return null;
    }
  }
  return bytes.length - at === tail ? elements : null;
}

/** Reads one byte of each element of a block; answers where the next ones begin, null where the bytes end before. */
function readPlane(bytes, from, plane, size, version, control) {
  if (control === 2) {
    plane.fill(0);
    return from;
  }
  if (control === 3) {
    if (bytes.length - from < size) return null;
    plane.set(bytes.subarray(from, from + size));
    return from + size;
  }
  const groups = Math.ceil(size / GROUP);
  let at = from + Math.ceil(groups / 4);
  const bitsOf = BITS[version === 0 ? 0 : 1 + control];
  for (let group = 0; group < groups; group++) {
    if (bytes.length - at < GROUP_LEFT) return null;
    const bits = bitsOf[(bytes[from + (group >> 2)] >> (2 * (group & 3))) & 3];
    at = readGroup(bytes, at, plane, group * GROUP, bits);
  }
  return at;
}

/** Sixteen bytes of so many bits each; of fewer than 8 the largest says that the byte stands behind them. */
function readGroup(bytes, from, plane, first, bits) {
  if (bits === 0) plane.fill(0, first, first + GROUP);
  if (bits === 8) plane.set(bytes.subarray(from, from + GROUP), first);
  let beside = from + 2 * bits;
  if (bits === 0 || bits === 8) return beside;
  const [each, most] = [8 / bits, (1 << bits) - 1];
  for (let at = 0; at < GROUP; at++) {
    const place = at % each;
    // Single bits begin with the lowest, pairs and fours with the highest.
    const shift = bits === 1 ? place : 8 - bits - bits * place;
    const value = (bytes[from + Math.floor(at / each)] >> shift) & most;
    plane[first + at] = value === most ? bytes[beside++] : value;
  }
  return beside;
}

/** Elements whose bytes are differences to those of the one before. */
function addBytes(planes, { elements, first, size, stride, byte }, last) {
  planes.forEach((plane, place) => {
    let value = last[byte + place];
    for (let at = 0; at < size; at++) {
      value = (value + signed(plane[at])) & 0xff;
      elements[(first + at) * stride + byte + place] = value;
    }
    last[byte + place] = value;
  });
}

/** The same with two bytes at a time. */
function addShorts(planes, { elements, first, size, stride, byte }, last) {
  for (const place of [0, 2]) {
    let value = last[byte + place] | (last[byte + place + 1] << 8);
    for (let at = 0; at < size; at++) {
      value = (value + signed(planes[place][at] | (planes[place + 1][at] << 8))) & 0xffff;
      const into = (first + at) * stride + byte + place;
      [elements[into], elements[into + 1]] = [value & 0xff, value >> 8];
    }
    [last[byte + place], last[byte + place + 1]] = [value & 0xff, value >> 8];
  }
}

/** The same with four bytes at a time, whose bits are turned to the right, and those that are set turn those of the one before over. */
function turnWords(planes, { elements, first, size, stride, byte }, last, turn) {
  const bytesOf = (word) => [word & 0xff, (word >> 8) & 0xff, (word >> 16) & 0xff, word >>> 24];
  let value = last[byte] | (last[byte + 1] << 8) | (last[byte + 2] << 16) | (last[byte + 3] << 24);
  for (let at = 0; at < size; at++) {
    const word = planes[0][at] | (planes[1][at] << 8) | (planes[2][at] << 16) | (planes[3][at] << 24);
    value ^= (word >>> turn) | (word << ((32 - turn) & 31));
    elements.set(bytesOf(value), (first + at) * stride + byte);
  }
  last.set(bytesOf(value), byte);
}

/** Numbers of seven bits a byte, the lowest first, of five bytes at most, the last of which has no eighth bit. */
class Numbers {
  constructor(bytes, at) {
    Object.assign(this, { bytes, at, last: 0 });
  }

  next() {
    let value = 0;
    for (let shift = 0; shift < 35; shift += 7) {
      const byte = this.bytes[this.at++];
      value |= (byte & 127) << shift;
      if (byte < 128) break;
    }
    return value >>> 0;
  }

  /** An index by its difference to the last that came so. */
  index() {
    return this.near(signed(this.next()));
  }

  near(by) {
    this.last = (this.last + by) >>> 0;
    return this.last;
  }
}

/** The last sixteen things, the latest by 0. */
class Latest {
  #things = new Array(16).fill(null);
  #count = 0;

  constructor(none) {
    this.#things.fill(none);
  }

  push(thing) {
    this.#things[this.#count++ & 15] = thing;
  }

  get(back) {
    return this.#things[(this.#count - 1 - back) & 15];
  }
}

/** Triangles by the edges and vertices of those before them; whether the bytes are these triangles and no more. */
function readTriangles(bytes, version, indices) {
  const count = indices.length / 3;
  const end = bytes.length - CODES;
  const numbers = new Numbers(bytes, 1 + count);
  // Vertices that are not there.
  const none = 2 ** 32 - 1;
  const [edges, vertices] = [new Latest([none, none]), new Latest(none)];
  let next = 0;
  // A vertex by its code: a new one, or one of the latest; those of numbers of their own come after.
  const vertexOf = (code) => (code === 0 ? next++ : vertices.get(code - 1));
  for (let triangle = 0; triangle < count; triangle++) {
    const code = bytes[1 + triangle];
    const [high, low] = [code >> 4, code & 15];
    let corners;
    if (high < 15) {
      const [a, b] = edges.get(high);
      const isNamed = low < (version === 0 ? 15 : 13);
      if (!isNamed && numbers.at > end) return false;
      const c = isNamed ? (low === 0 ? next++ : vertices.get(low)) : low === 15 ? numbers.index() : numbers.near(2 * low - 27);
      if (low === 0 || !isNamed) vertices.push(c);
      corners = [a, b, c];
      edges.push([c, b]);
      edges.push([a, c]);
    } else {
      const isOfTable = low < 14;
      if (!isOfTable && numbers.at > end) return false;
      const codes = isOfTable ? bytes[end + low] : bytes[numbers.at++];
      if (!isOfTable && codes === 0) next = 0;
      const [second, third] = [codes >> 4, codes & 15];
      const isOwn = (of) => !isOfTable && of === 15;
      let a = low === 15 ? 0 : next++;
      let [b, c] = [vertexOf(second), vertexOf(third)];
      if (low === 15) a = numbers.index();
      if (isOwn(second)) b = numbers.index();
      if (isOwn(third)) c = numbers.index();
      corners = [a, b, c];
      vertices.push(a);
      if (second === 0 || isOwn(second)) vertices.push(b);
      if (third === 0 || isOwn(third)) vertices.push(c);
      edges.push([b, a]);
      edges.push([c, b]);
      edges.push([a, c]);
    }
    indices.set(corners, 3 * triangle);
  }
  return numbers.at === end;
}

/** Indices, each a difference to one of two before; whether the bytes are these and no more. */
function readIndices(bytes, indices) {
  const end = bytes.length - INDICES_TAIL;
  const numbers = new Numbers(bytes, 1);
  const last = [0, 0];
  for (let at = 0; at < indices.length; at++) {
    if (numbers.at >= end) return false;
    const value = numbers.next();
    last[value & 1] = (last[value & 1] + signed(value >>> 1)) >>> 0;
    indices[at] = last[value & 1];
  }
  return numbers.at === end;
}
