// The points of receivers' texels that E_dir is the mean over: those of their coverage, where the meshes have them; twin of
// client/src/passes/direct/points.rs. Sums are in f32 there and here: points lie on the edges of triangles.

import { COLOUR, LIGHTMAP_TEXEL, NORMAL, POSITION, VERTEX_NUMBERS } from "./draws.js";
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
// Numbers of a corner of a triangle that points are mixed of: place and normal.
const MIXED = COLOUR - 2;

// Numbers that put the points of many texels in an order whose first few lie far apart.
function spread(block, x, y, bit) {
  const place = Math.imul(block ^ ((y << 16) | x), 0x9e3779b1) ^ bit;
  return Math.imul(place ^ (place >>> 15), 0x85ebca77) >>> 1;
}

/** Points of all texels. */
export class TexelPoints {
  #found = {
    slots: new Growing(Uint32Array),
    orders: new Growing(Uint32Array),
    // Offset from the receiver in metres, then octahedral normal: five numbers each.
    points: new Growing(Float32Array),
  };

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
    for (let triangle = 0; triangle < draw.triangles.length; triangle += 3) {
      const corners = [0, 1, 2].map((corner) => {
        const first = VERTEX_NUMBERS * draw.triangles[triangle + corner];
        return draw.vertices.subarray(first, first + VERTEX_NUMBERS);
      });
      ofTriangle(corners, side, size, (x, y, bit, pointOf) => {
        const slot = slots.slot(block, x, y);
        if (slot !== NO_SLOT && (receivers.coverage[slot] >>> bit) & 1) {
          this.#push(receivers, slot, PLACE[bit], pointOf());
        } else if (slots.hasSides && MIDDLE.includes(bit)) {
          const other = slots.standingInside(block, x, y);
          if (other !== NO_SLOT) {
            this.#push(receivers, other, OF_OTHERS + spread(block, x, y, bit), pointOf());
          }
        }
      });
    }
  }

  #push(receivers, slot, order, { place, normal }) {
    this.#found.slots.push(slot);
    this.#found.orders.push(order);
    const offset = place.map((value, axis) => fround(value - receivers.positionM[4 * slot + axis]));
    this.#found.points.extend([...offset, ...folded(normal)]);
  }

  // Sorts by slot and order, and packs: offsets as snorm16 of the reach, normals as snorm8.
  #pack(receivers) {
    const slots = this.#found.slots.finish();
    const orders = this.#found.orders.finish();
    const points = this.#found.points.finish();
    const kept = keptOf(slots, orders, receivers);
    let reach = 2 ** -126;
    for (const index of kept.indices) {
      for (let axis = 0; axis < 3; axis++) {
        reach = Math.max(reach, Math.abs(points[5 * index + axis]));
      }
    }
    this.reachM = reach;
    // First point of each slot, and the end.
    this.starts = kept.starts;
    // Two words each, as shaders read them.
    this.points = new Uint32Array(2 * kept.indices.length);
    kept.indices.forEach((index, at) => {
      const of = (place, scale, most) => snorm(fround(points[5 * index + place] / scale), most);
      const [x, y, z] = [0, 1, 2].map((axis) => of(axis, reach, 32767) & 0xffff);
      const [u, v] = [3, 4].map((place) => of(place, 1, 127) & 0xff);
      this.points[2 * at] = x | (y << 16);
      this.points[2 * at + 1] = z | (u << 16) | (v << 24);
    });
  }
}

// Which of the points found are kept, by slot and order, and the first of each slot. A point on an edge lies on two triangles;
// a receiver that stands for others is the mean over a point of its own and two of each of them.
function keptOf(slots, orders, receivers) {
  const firsts = new Uint32Array(receivers + 1);
  slots.forEach((slot) => firsts[slot + 1]++);
  for (let slot = 0; slot < receivers; slot++) {
    firsts[slot + 1] += firsts[slot];
  }
  const next = firsts.slice();
  const bySlot = new Uint32Array(slots.length);
  slots.forEach((slot, index) => (bySlot[next[slot]++] = index));
  const starts = new Uint32Array(receivers + 1);
  const kept = new Growing(Uint32Array);
  for (let slot = 0; slot < receivers; slot++) {
    const own = bySlot.subarray(firsts[slot], firsts[slot + 1]).sort((a, b) => orders[a] - orders[b] || a - b);
    const standsForOthers = own.length > 0 && orders[own.at(-1)] >= OF_OTHERS;
    own.forEach((index, at) => {
      const isDouble = at > 0 && orders[own[at - 1]] === orders[index];
      const isWanted = at === 0 || orders[index] >= OF_OTHERS || !standsForOthers;
      if (!isDouble && isWanted) {
        kept.push(index);
      }
    });
    starts[slot + 1] = kept.length;
  }
  return { starts, indices: kept.finish() };
}

// Calls `met` with the texel and bit of each point in a block of `size` texels that the triangle holds, on its rim too, and a
// function that gives the point.
function ofTriangle(corners, side, size, met) {
  const [a, b, c] = corners.map((corner) => [
    fround(corner[LIGHTMAP_TEXEL] * COVERAGE_SIDE),
    fround(corner[LIGHTMAP_TEXEL + 1] * COVERAGE_SIDE),
  ]);
  const area = crossed(less(b, a), less(c, a));
  if (area === 0 || !Number.isFinite(area)) {
    return;
  }
  const bounds = (axis) => {
    const last = size[axis] * COVERAGE_SIDE - 1;
    const along = [a[axis], b[axis], c[axis]];
    const low = clamped(Math.ceil(fround(Math.min(...along) - 0.5)), 0, last);
    return [low, clamped(Math.floor(fround(Math.max(...along) - 0.5)), -1, last)];
  };
  const [[left, right], [top, bottom]] = [bounds(0), bounds(1)];
  const edges = [[b, c], [c, a], [a, b]].map(([from, to]) => ({ from, along: less(to, from) }));
  for (let y = top; y <= bottom; y++) {
    for (let x = left; x <= right; x++) {
      const at = [x + 0.5, y + 0.5];
      // Each edge by itself, so that two triangles that share one leave no point between them.
      const shares = edges.map(({ from, along }) => fround(crossed(along, less(at, from)) / area));
      if (shares.every((share) => share >= 0)) {
        const bit = (y % COVERAGE_SIDE) * COVERAGE_SIDE + (x % COVERAGE_SIDE);
        met(Math.floor(x / COVERAGE_SIDE), Math.floor(y / COVERAGE_SIDE), bit, () => pointOf(corners, shares, side));
      }
    }
  }
}

// Place in metres and unit normal of a point of a triangle.
function pointOf(corners, shares, side) {
  const total = fround(fround(shares[0] + shares[1]) + shares[2]);
  const mixed = new Float32Array(MIXED);
  for (let i = 0; i < MIXED; i++) {
    for (let corner = 0; corner < 3; corner++) {
      mixed[i] += fround(corners[corner][i] * shares[corner]);
    }
    mixed[i] /= total;
  }
  const [p, q, r] = corners.map((corner) => corner.subarray(POSITION, POSITION + 3));
  const face = normalised(cross(less(q, p), less(r, p))) ?? Array.from(corners[0].subarray(NORMAL, NORMAL + 3));
  const shading = normalised(mixed.subarray(NORMAL, NORMAL + 3)) ?? [0, 0, 0];
  // A shading normal that points through the surface is a fault of the file.
  const agrees = shading[0] * face[0] + shading[1] * face[1] + shading[2] * face[2] > 0.05;
  const normal = (agrees ? shading : face).map((value) => value * side);
  return { place: Array.from(mixed.subarray(POSITION, POSITION + 3)), normal };
}

function less(a, b) {
  return Array.from(a, (value, axis) => fround(value - b[axis]));
}

function crossed([ax, ay], [bx, by]) {
  return fround(fround(ax * by) - fround(ay * bx));
}

function cross([ax, ay, az], [bx, by, bz]) {
  return [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
}

function normalised(vector) {
  const length = Math.hypot(...vector);
  return length > 0 && Number.isFinite(1 / length) ? Array.from(vector, (value) => value / length) : null;
}

function snorm(value, most) {
  return rounded(fround(clamped(value, -1, 1) * most));
}

// Unit vector → octahedral coordinates.
function folded(normal) {
  const sum = Math.max(Math.abs(normal[0]) + Math.abs(normal[1]) + Math.abs(normal[2]), 2 ** -126);
  const [x, y, z] = normal.map((value) => value / sum);
  const sign = (value) => (value >= 0 ? 1 : -1);
  return z >= 0 ? [x, y] : [(1 - Math.abs(y)) * sign(x), (1 - Math.abs(x)) * sign(y)];
}
