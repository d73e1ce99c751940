// The points of receivers' texels that E_dir is the mean over: those of their coverage, where the meshes have them; twin of
// client/src/passes/direct/points.rs. Sums are in f32 there and here: points lie on the edges of triangles.

import { LIGHTMAP_TEXEL, NORMAL, POSITION, VERTEX_NUMBERS } from "./draws.js";
import { Growing } from "./growing.js";
import { NO_BLOCK } from "./layout.js";
import { clamped, fround, rounded } from "./numbers.js";
import { NO_SLOT } from "./slots.js";

// Points along each side of a texel.
const COVERAGE_SIDE = 4;
// Bits of the coverage in the order of the points: the first four, then the others by rows; and the place of each bit there.
const ORDER = [1, 7, 8, 14, 0, 2, 3, 4, 5, 6, 9, 10, 11, 12, 13, 15];
const PLACE = ORDER.map((_, bit) => ORDER.indexOf(bit));
// Points in the middle of a texel that stand for it where its receiver is not there.
const MIDDLE = [5, 10];
// Bit of the order of points of other texels.
const OF_OTHERS = 0x80000000;
// Numbers of a corner that points are mixed of: place and normal.
const MIXED = 6;

/** Numbers that put the points of many texels in an order whose first few lie far apart. */
function spread(block, x, y, bit) {
  const place = Math.imul(block ^ ((y << 16) | x), 0x9e3779b1) ^ bit;
  return Math.imul(place ^ (place >>> 15), 0x85ebca77) >>> 1;
}

/** Points of all texels. */
export class TexelPoints {
  #slots = new Growing(Uint32Array);
  #orders = new Growing(Uint32Array);
  // Offset from the receiver in metres, then octahedral normal: five numbers each.
  #points = new Growing(Float32Array);

  constructor(draws, layout, slots, receivers) {
    for (const draw of draws) {
      for (const [block, side] of [[draw.front, 1], [draw.back, -1]]) {
        if (block !== NO_BLOCK) {
          this.#ofDraw(draw, block, side, layout.blocks[block].size, slots, receivers);
        }
      }
    }
    this.#pack(receivers.count);
  }

  #ofDraw(draw, block, side, size, slots, receivers) {
    for (let first = 0; first < draw.triangles.length; first += 3) {
      const corners = [0, 1, 2].map((corner) => {
        const vertex = VERTEX_NUMBERS * draw.triangles[first + corner];
        return draw.vertices.subarray(vertex, vertex + VERTEX_NUMBERS);
      });
      const triangle = new Triangle(corners, side, size);
      for (let y = triangle.top; y <= triangle.bottom; y++) {
        for (let x = triangle.left; x <= triangle.right; x++) {
          if (triangle.holds(x, y)) {
            this.#met(triangle, block, x, y, slots, receivers);
          }
        }
      }
    }
  }

  /** A point of a triangle, by its place in quarters of texels. */
  #met(triangle, block, x, y, slots, receivers) {
    const bit = (y % COVERAGE_SIDE) * COVERAGE_SIDE + (x % COVERAGE_SIDE);
    const column = Math.floor(x / COVERAGE_SIDE);
    const row = Math.floor(y / COVERAGE_SIDE);
    const slot = slots.slot(block, column, row);
    if (slot !== NO_SLOT && (receivers.coverage[slot] >>> bit) & 1) {
      this.#push(triangle, slot, PLACE[bit], receivers);
    } else if (slots.hasSides && MIDDLE.includes(bit)) {
      const other = slots.standingInside(block, column, row);
      if (other !== NO_SLOT) {
        this.#push(triangle, other, OF_OTHERS + spread(block, column, row, bit), receivers);
      }
    }
  }

  #push(triangle, slot, order, { positionM }) {
    this.#slots.push(slot);
    this.#orders.push(order);
    const { place, normal } = triangle.point();
    for (let axis = 0; axis < 3; axis++) {
      this.#points.push(place[axis] - positionM[4 * slot + axis]);
    }
    pushFolded(this.#points, normal);
  }

  /** Sorts by slot and order, and packs: offsets as snorm16 of the reach, normals as snorm8. */
  #pack(receivers) {
    const points = this.#points.finish();
    const { starts, indices } = keptOf(this.#slots.finish(), this.#orders.finish(), receivers);
    let reach = 2 ** -126;
    for (const index of indices) {
      for (let axis = 0; axis < 3; axis++) {
        reach = Math.max(reach, Math.abs(points[5 * index + axis]));
      }
    }
    this.reachM = reach;
    // First point of each slot, and the end.
    this.starts = starts;
    // Two words each, as shaders read them.
    this.points = new Uint32Array(2 * indices.length);
    const offset = (at) => snorm(fround(points[at] / reach), 32767) & 0xffff;
    for (let at = 0; at < indices.length; at++) {
      const first = 5 * indices[at];
      const u = snorm(points[first + 3], 127) & 0xff;
      const v = snorm(points[first + 4], 127) & 0xff;
      this.points[2 * at] = offset(first) | (offset(first + 1) << 16);
      this.points[2 * at + 1] = offset(first + 2) | (u << 16) | (v << 24);
    }
  }
}

/**
 * Which of the points found are kept, by slot and order, and the first of each slot. A point on an edge lies on two triangles;
 * a receiver that stands for others is the mean over a point of its own and two of each of them.
 */
function keptOf(slots, orders, receivers) {
  const { firsts, bySlot } = sortedBySlot(slots, receivers);
  const starts = new Uint32Array(receivers + 1);
  const kept = new Growing(Uint32Array);
  for (let slot = 0; slot < receivers; slot++) {
    const [first, end] = [firsts[slot], firsts[slot + 1]];
    sortByOrder(bySlot, first, end, orders);
    const standsForOthers = end > first && orders[bySlot[end - 1]] >= OF_OTHERS;
    for (let at = first; at < end; at++) {
      const order = orders[bySlot[at]];
      const isDouble = at > first && orders[bySlot[at - 1]] === order;
      if (!isDouble && (at === first || order >= OF_OTHERS || !standsForOthers)) {
        kept.push(bySlot[at]);
      }
    }
    starts[slot + 1] = kept.length;
  }
  return { starts, indices: kept.finish() };
}

/** Indices in the order of their slots, in which they stand as they came, and the first of each slot. */
function sortedBySlot(slots, receivers) {
  const firsts = new Uint32Array(receivers + 1);
  for (const slot of slots) {
    firsts[slot + 1]++;
  }
  for (let slot = 0; slot < receivers; slot++) {
    firsts[slot + 1] += firsts[slot];
  }
  const next = firsts.slice();
  const bySlot = new Uint32Array(slots.length);
  slots.forEach((slot, index) => (bySlot[next[slot]++] = index));
  return { firsts, bySlot };
}

/** Sorts a short run of indices by their order, by insertion, so that equals stay as they came. */
function sortByOrder(indices, first, end, orders) {
  for (let at = first + 1; at < end; at++) {
    const index = indices[at];
    let to = at;
    for (; to > first && orders[indices[to - 1]] > orders[index]; to--) {
      indices[to] = indices[to - 1];
    }
    indices[to] = index;
  }
}

/** A triangle in a block of `size` texels, on the lattice of points: four along each side of a texel. */
class Triangle {
  #corners;
  #side;
  #edges;
  #area;
  #shares = new Float32Array(3);
  #face = null;
  #mixed = new Float32Array(MIXED);

  constructor(corners, side, size) {
    this.#corners = corners;
    this.#side = side;
    const [a, b, c] = corners.map((corner) => [
      fround(corner[LIGHTMAP_TEXEL] * COVERAGE_SIDE),
      fround(corner[LIGHTMAP_TEXEL + 1] * COVERAGE_SIDE),
    ]);
    this.#edges = [[b, c], [c, a], [a, b]].map(([from, to]) => {
      return { fromX: from[0], fromY: from[1], alongX: fround(to[0] - from[0]), alongY: fround(to[1] - from[1]) };
    });
    this.#area = crossed(fround(b[0] - a[0]), fround(b[1] - a[1]), fround(c[0] - a[0]), fround(c[1] - a[1]));
    const bounds = (axis) => {
      const last = size[axis] * COVERAGE_SIDE - 1;
      const along = [a[axis], b[axis], c[axis]];
      const low = clamped(Math.ceil(fround(Math.min(...along) - 0.5)), 0, last);
      return [low, clamped(Math.floor(fround(Math.max(...along) - 0.5)), -1, last)];
    };
    [this.left, this.right] = bounds(0);
    [this.top, this.bottom] = bounds(1);
    if (this.#area === 0 || !Number.isFinite(this.#area)) {
      this.bottom = -1;
    }
  }

  /**
   * Whether the triangle holds the middle of a place of the lattice, on its rim too. Each edge is asked by itself, so that two
   * triangles that share one leave no point between them.
   */
  holds(x, y) {
    for (let edge = 0; edge < 3; edge++) {
      const { fromX, fromY, alongX, alongY } = this.#edges[edge];
      const share = crossed(alongX, alongY, fround(x + 0.5 - fromX), fround(y + 0.5 - fromY)) / this.#area;
      this.#shares[edge] = share;
      if (!(share >= 0)) {
        return false;
      }
    }
    return true;
  }

  /** Place in metres and unit normal of the point that was held last. */
  point() {
    const [corners, shares, mixed] = [this.#corners, this.#shares, this.#mixed];
    const total = fround(fround(shares[0] + shares[1]) + shares[2]);
    for (let i = 0; i < MIXED; i++) {
      const first = fround(fround(corners[0][i] * shares[0]) + fround(corners[1][i] * shares[1]));
      mixed[i] = fround(first + fround(corners[2][i] * shares[2])) / total;
    }
    const normal = mixed.subarray(NORMAL, NORMAL + 3);
    this.#face ??= this.#faceNormal();
    const face = this.#face;
    const length = Math.hypot(normal[0], normal[1], normal[2]);
    // A shading normal that points through the surface is a fault of the file.
    const agrees = normal[0] * face[0] + normal[1] * face[1] + normal[2] * face[2] > 0.05 * length;
    for (let axis = 0; axis < 3; axis++) {
      normal[axis] = this.#side * (agrees ? normal[axis] / length : face[axis]);
    }
    return { place: mixed, normal };
  }

  #faceNormal() {
    const [p, q, r] = this.#corners.map((corner) => corner.subarray(POSITION, POSITION + 3));
    const [ax, ay, az] = less(q, p);
    const [bx, by, bz] = less(r, p);
    const face = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
    const length = Math.hypot(...face);
    const isOne = length > 0 && Number.isFinite(1 / length);
    return isOne ? face.map((value) => value / length) : this.#corners[0].subarray(NORMAL, NORMAL + 3);
  }
}

function less(a, b) {
  return Array.from(a, (value, axis) => fround(value - b[axis]));
}

/** Cross product of two vectors of the plane, in f32. */
function crossed(ax, ay, bx, by) {
  return fround(fround(ax * by) - fround(ay * bx));
}

function snorm(value, most) {
  return rounded(fround(clamped(value, -1, 1) * most));
}

/** Appends a unit vector in octahedral coordinates. */
function pushFolded(to, [nx, ny, nz]) {
  const sum = Math.max(Math.abs(nx) + Math.abs(ny) + Math.abs(nz), 2 ** -126);
  const [x, y] = [nx / sum, ny / sum];
  to.push(nz >= 0 ? x : (1 - Math.abs(y)) * (x >= 0 ? 1 : -1));
  to.push(nz >= 0 ? y : (1 - Math.abs(x)) * (y >= 0 ? 1 : -1));
}
