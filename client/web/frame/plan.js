// Shadow maps of a set of lights: six faces around a point, one for a narrow spot, tiles for a sun, half a cube of five faces
// before each point of a rectangle; twin of client/src/passes/shadow/plan.rs.

import { rounded } from "../relight/numbers.js";
import { RECT, SPOT, SUN } from "./lights.js";
import { add, dot, less, lookAlong, normalised, parallel, perspective, product, times, transformed, translation } from "./maths.js";

// Most texels of all shadow maps together.
const MAX_TEXELS = 2 ** 26;
// Most faces: layers of one texture.
const MAX_FACES = 256;
// Longest and shortest side of a face in texels.
const MAX_SIDE = 4096;
const MIN_SIDE = 64;
// Faces along each side of a sun's box.
const SUN_TILES = 2;
// Most cascades of a sun, and the factor by which the texels of each are finer than those of the one before.
const CASCADES_MAX = 3;
const CASCADE_STEP = 4;
// Side of a shadow texel in metres that is fine enough for any picture.
const FINEST_M = 1e-3;
// Texels around a face that neighbours share, so that the filter stays inside.
const GUARD_TEXELS = 4;
// Widest spot that one perspective face covers; wider ones get six.
const SPOT_COS_MIN = 0.6;
// Faces before each point of a rectangle: half a cube.
const RECT_FACES = 5;
// Directions of a cube's faces and their up vectors, in the order of `cube_face`; the first five are before a rectangle.
const CUBE = [
  [[1, 0, 0], [0, 1, 0]],
  [[-1, 0, 0], [0, 1, 0]],
  [[0, 1, 0], [0, 0, 1]],
  [[0, -1, 0], [0, 0, 1]],
  [[0, 0, 1], [0, 1, 0]],
  [[0, 0, -1], [0, 1, 0]],
];
/** Bytes of a light and of a face as shaders read them. */
export const LIGHT_BYTES = 96;
export const FACE_BYTES = 96;

/** Whether a room is no more than any adapter is asked for. */
export function isRoom({ lights, faces, side }) {
  const isSide = Number.isInteger(Math.log2(side)) && side >= MIN_SIDE && side <= MAX_SIDE;
  return isSide && lights <= MAX_FACES && faces <= MAX_FACES && faces * side * side <= MAX_TEXELS;
}

/** Errs where a room is more than any adapter is asked for. */
export function checkRoom(room) {
  const { lights, faces, side } = room;
  if (!isRoom(room)) {
    throw new Error(
      `room for ${lights} lights and ${faces} shadow maps of ${side} texels a side: sides are powers of two in ` +
        `${MIN_SIDE}..=${MAX_SIDE}, lights and maps at most ${MAX_FACES}, their texels at most ${MAX_TEXELS}`,
    );
  }
}

/** Room for these lights, with as many cascades as the limits allow, and faces of at most `side` texels. */
export function roomFor(casters, side) {
  const faces = casters.reduce((sum, caster) => sum + faceCount(caster), 0);
  let own = side;
  while (faces * own * own > MAX_TEXELS) {
    own /= 2;
  }
  const most = Math.min(Math.floor(MAX_TEXELS / (own * own)), MAX_FACES);
  const suns = casters.filter(({ shape }) => shape === SUN).length;
  return { lights: casters.length, faces: Math.max(Math.min(faces + suns * CASCADES_MAX, most), faces), side: own };
}

/**
 * Lights and the faces that they need, within a room; suns get cascades about the `eye` of a perspective, which come last. `snap` is
 * the device's (snap.js).
 */
export class ShadowPlan {
  constructor(room, casters, boundsM, eye, snap) {
    const faces = casters.reduce((sum, caster) => sum + faceCount(caster), 0);
    if (faces > room.faces || casters.length > room.lights) {
      throw new Error(
        `${casters.length} lights need ${faces} shadow maps: there is room for ${room.lights} and ${room.faces}; ` +
          "use fewer lights, or fewer points of rectangles, or make the frame with more room",
      );
    }
    const [low, high] = boundsM;
    const diagonal = Math.max(Math.hypot(...less(high, low)), 2 ** -126);
    this.side = room.side;
    this.snap = snap;
    this.biasM = 5e-5 * diagonal;
    this.lights = [];
    this.faces = [];
    for (const caster of casters) {
      this.#push(caster, boundsM, diagonal);
    }
    this.firstCascade = this.faces.length;
    if (eye !== null) {
      this.#pushCascades(eye, 0.5005 * diagonal, room.faces);
    }
  }

  /** Lights as shaders read them. */
  lightBytes() {
    const bytes = new ArrayBuffer(LIGHT_BYTES * this.lights.length);
    const [floats, words] = [new Float32Array(bytes), new Uint32Array(bytes)];
    this.lights.forEach((light, index) => {
      const at = (LIGHT_BYTES / 4) * index;
      floats.set([...light.position, light.range, ...light.direction], at);
      words[at + 7] = light.shape;
      floats.set(light.strength, at + 8);
      words[at + 11] = light.firstFace;
      floats.set(light.cone, at + 12);
      words[at + 14] = light.faceCount;
      floats[at + 15] = light.halfExtent;
      words.set([light.firstCascade, light.cascades], at + 16);
      floats.set([Math.hypot(...light.halfU), Math.hypot(...light.halfV)], at + 18);
      words.set(light.cells, at + 20);
    });
    return bytes;
  }

  /** Faces as shaders read them; `hasPanes` says that the maps of glass hold anything. */
  faceNumbers(hasPanes) {
    const numbers = this.faces.flatMap(({ matrix, right, up, texelAtUnitW }) => {
      return [...matrix, ...right, texelAtUnitW, ...up, hasPanes ? 1 : 0];
    });
    return Float32Array.from(numbers);
  }

  /** Numbers for all lights as shaders read them. */
  countBytes() {
    const bytes = new ArrayBuffer(16);
    new Uint32Array(bytes).set([this.lights.length, this.side]);
    new Float32Array(bytes).set([this.biasM, this.snap], 2);
    return bytes;
  }

  /** Whether two plans have the same faces. */
  hasFacesOf(other) {
    const numbers = other.faceNumbers(false);
    return this.faces.length === other.faces.length && this.faceNumbers(false).every((x, at) => x === numbers[at]);
  }

  #push(caster, boundsM, diagonal) {
    const [low, high] = boundsM;
    const centre = times(add(low, high), 0.5);
    const isSun = caster.shape === SUN;
    const halfExtent = isSun ? sunHalfExtent(caster.direction, boundsM) : 0;
    const position = isSun ? centre : caster.position;
    const faces = faceCount(caster);
    this.lights.push({
      ...caster,
      position,
      firstFace: this.faces.length,
      faceCount: faces,
      halfExtent,
      firstCascade: 0,
      cascades: 0,
    });
    const near = 1e-4 * diagonal;
    if (caster.shape === RECT) {
      this.#pushRect(caster, near);
    } else if (isSun) {
      this.#pushSun(caster.direction, centre, halfExtent, 0.5005 * diagonal);
    } else if (faces === 6) {
      CUBE.forEach(([forward, up]) => this.#pushPerspective(position, forward, up, 1, near));
    } else {
      const cos = Math.max(caster.cone[1], 0.01);
      const tan = Math.sqrt(Math.max(1 - cos * cos, 0)) / cos;
      this.#pushPerspective(position, caster.direction, anyUp(caster.direction), tan, near);
    }
  }

  #pushPerspective(eye, forward, up, tan, near) {
    const own = (tan * this.side) / (this.side - 2 * GUARD_TEXELS);
    const view = lookAlong(eye, forward, up);
    this.#pushFace(product(perspective(own, own, near), view.matrix), view, (2 * own) / this.side);
  }

  /** Half a cube before the middle of each cell, row by row; in each the face along the light comes last. */
  #pushRect({ position, direction, halfU, halfV, cells: [columns, rows] }, near) {
    const axes = [normalised(halfU), normalised(halfV), direction];
    const inWorld = (local) => local.map((value, axis) => times(axes[axis], value)).reduce(add);
    const along = (index, count) => (2 * index + 1) / count - 1;
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const aside = add(times(halfU, along(column, columns)), times(halfV, along(row, rows)));
        for (const [forward, up] of CUBE.slice(0, RECT_FACES)) {
          this.#pushPerspective(add(position, aside), inWorld(forward), inWorld(up), 1, near);
        }
      }
    }
  }

  /** `halfExtent` across and `reach` along the light, from the centre, in metres. */
  #pushSun(direction, centre, halfExtent, reach) {
    const halfTile = halfExtent / SUN_TILES;
    const half = (halfTile * this.side) / (this.side - 2 * GUARD_TEXELS);
    const view = sunView(direction, centre, reach);
    const offset = (index) => (2 * index + 1 - SUN_TILES) * halfTile;
    for (let row = 0; row < SUN_TILES; row++) {
      for (let column = 0; column < SUN_TILES; column++) {
        const shift = translation([-offset(column), -offset(row), 0]);
        const projection = product(parallel(half, half, 2 * reach), shift);
        this.#pushFace(product(projection, view.matrix), view, (2 * half) / this.side);
      }
    }
  }

  /** Cascades of every sun, as long as there is room for `facesMax` faces. */
  #pushCascades(eye, reach, facesMax) {
    const finestM = FINEST_M * Math.min(2 * reach, 1);
    for (const light of this.lights) {
      light.firstCascade = this.faces.length;
      for (let cascade = 0; cascade < CASCADES_MAX; cascade++) {
        // Texels of a tile are as wide as half the box over the side.
        const half = (0.5 * light.halfExtent) / CASCADE_STEP ** (cascade + 1);
        const texelM = (2 * half) / this.side;
        if (light.shape !== SUN || texelM < finestM || this.faces.length >= facesMax) {
          break;
        }
        const view = sunView(light.direction, light.position, reach);
        // Most of it lies before the eye, and it moves by whole texels.
        const middle = transformed(view.matrix, add(eye.positionM, times(eye.forward, 0.75 * half)));
        const [x, y] = middle.map((value) => rounded(value / texelM) * texelM);
        const projection = product(parallel(half, half, 2 * reach), translation([-x, -y, 0]));
        this.#pushFace(product(projection, view.matrix), view, texelM);
        light.cascades += 1;
      }
    }
  }

  #pushFace(matrix, { right, up }, texelAtUnitW) {
    this.faces.push({ matrix, right, up, texelAtUnitW });
  }
}

function sunView(direction, centre, reach) {
  return lookAlong(less(centre, times(direction, reach)), direction, anyUp(direction));
}

function anyUp(forward) {
  return Math.abs(forward[1]) > 0.9 ? [1, 0, 0] : [0, 1, 0];
}

/** Half side of the square across a sun's light that holds the whole box, in metres. */
function sunHalfExtent(direction, [low, high]) {
  const halfSize = less(high, low).map((size) => 0.5 * Math.abs(size));
  const { right, up } = lookAlong([0, 0, 0], direction, anyUp(direction));
  const half = (row) => dot(row.map(Math.abs), halfSize);
  return Math.max(1.001 * Math.max(half(right), half(up)), 2 ** -126);
}

function faceCount({ shape, cone, cells }) {
  if (shape === RECT) {
    return RECT_FACES * cells[0] * cells[1];
  }
  if (shape === SUN) {
    return SUN_TILES * SUN_TILES;
  }
  return shape === SPOT && cone[1] >= SPOT_COS_MIN ? 1 : 6;
}
