// Objects that move: meshes beside a bake's, drawn and lit by lights, that stand in all shadow maps; none of their light is baked. Twin
// of client/src/scene/objects.rs.

import { texturesOf } from "../chunk/manifest.js";
import { interleaved, NORMAL, POSITION, VERTEX_NUMBERS, problemOf } from "../relight/draws.js";
import { NO_BLOCK } from "../relight/layout.js";
import { fround } from "../relight/numbers.js";
import { isSame } from "./same.js";

// Most objects beside a bake.
const OBJECTS_MAX = 256;
// Steps by which the scene's bounds grow with an object beyond them, of which so many are the bake's diagonal.
const BOUNDS_STEPS = 8;
const DEGREE = Math.PI / 180;
const NONE = new Float32Array(0);

/**
 * Where an object stands that nothing is said of: at rest at the origin. It is scaled, then turned by degrees, yaw about y, pitch about x
 * and roll about z, then moved; `clip` counts its animations from 0, and `timeS` is a time of it.
 */
export const REST = Object.freeze({ positionM: [0, 0, 0], turnDeg: [0, 0, 0], scale: 1, clip: 0, timeS: 0 });

/** A bake's scene with objects beside it. */
export class ObjectSet {
  // By object: `{object, stance, firstDraw, firstMaterial, sizes, local, boundsM}`.
  #placed = [];

  /** Puts objects where stances have them, `REST` where absent. Errs where meshes contradict themselves or their materials. */
  constructor(own, objects, stances) {
    this.own = own;
    if (objects.length > OBJECTS_MAX) {
      throw new Error(`${objects.length} objects are too many: a scene has at most ${OBJECTS_MAX}`);
    }
    /** The scene with the objects' meshes, materials and textures behind its own. */
    this.scene = {
      ...own,
      draws: [...own.draws],
      textures: [...own.textures],
      manifest: { ...own.manifest, materials: [...own.manifest.materials] },
    };
    objects.forEach((object, at) => this.#add(object, stanceOf(stances[at], at)));
  }

  #add(object, stance) {
    const { draws, textures, manifest } = this.scene;
    const { name, materials } = object;
    for (const material of materials) {
      const bad = texturesOf(material).find(({ texture }) => !(texture < object.textures.length));
      if (bad) throw refused(name, `has a material '${material.name}' that names texture ${bad.texture} of ${object.textures.length}`);
    }
    const placed = { object, stance, firstDraw: draws.length, firstMaterial: manifest.materials.length, sizes: null, local: null };
    this.#pose(placed, REST);
    placed.sizes = placed.local.meshes.map(sizeOf);
    if (placed.sizes.length === 0) throw refused(name, "has no triangles");
    const meshes = this.#pose(placed, stance);
    draws.push(...meshes);
    placed.boundsM = boundsOf(meshes);
    manifest.materials.push(...materials.map((material) => shifted(material, textures.length)));
    textures.push(...object.textures);
    this.#placed.push(placed);
  }

  /** The objects, in their order. */
  get objects() {
    return this.#placed.map(({ object }) => object);
  }

  /** Where they stand. */
  get stances() {
    return this.#placed.map(({ stance }) => stance);
  }

  /** Meshes of an object where it stands, `{vertices, triangles}` in world space. */
  drawsOf(index) {
    const { firstDraw, sizes } = this.#placed[index];
    return this.scene.draws.slice(firstDraw, firstDraw + sizes.length);
  }

  /** Stances of other objects: those that are given, else those that objects of these have here, else rest. */
  stancesFor(objects, given) {
    const here = [...this.#placed];
    return objects.map((object, at) => {
      const found = here.findIndex((placed) => placed.object === object);
      const [kept] = found < 0 ? [] : here.splice(found, 1);
      return given[at] ?? kept?.stance ?? REST;
    });
  }

  /** Objects that other stances move, `{index, stance, meshes, boundsM}`; those without a stance come to rest. Changes nothing. */
  moved(stances) {
    if (stances.length > this.#placed.length) {
      throw new Error(`${stances.length} stances are given for ${this.#placed.length} objects: give each its object`);
    }
    return this.#placed.flatMap((placed, index) => {
      const stance = stanceOf(stances[index], index);
      if (isSame(stance, placed.stance)) return [];
      const meshes = this.#pose(placed, stance);
      return [{ index, stance, meshes, boundsM: boundsOf(meshes) }];
    });
  }

  /** Moves objects, and calls `write` with the number of each mesh that moves, and the mesh. */
  take(moved, write) {
    for (const { index, stance, meshes, boundsM } of moved) {
      const placed = this.#placed[index];
      Object.assign(placed, { stance, boundsM });
      meshes.forEach((mesh, at) => {
        this.scene.draws[placed.firstDraw + at] = mesh;
        write(placed.firstDraw + at, mesh);
      });
    }
  }

  /** Bounds of the bake alone. */
  get ownBoundsM() {
    const { boundsM } = this.own.manifest;
    return [Array.from(boundsM.slice(0, 3)), Array.from(boundsM.slice(3, 6))];
  }

  /**
   * Bounds of the scene in metres with objects that move so. A side moves outwards by steps of an eighth of the bake's diagonal, by a
   * whole one at most: shadow maps of suns stay while an object moves beyond the bake's bounds, and one far away takes no detail from them.
   */
  boundsWith(moved = []) {
    const [low, high] = this.ownBoundsM;
    const bounds = this.#placed.map((placed, at) => moved.find(({ index }) => index === at)?.boundsM ?? placed.boundsM);
    const step = Math.max(fround(Math.hypot(...low.map((side, axis) => high[axis] - side)) / BOUNDS_STEPS), 2 ** -126);
    const margin = (beyond) => Math.min(Math.ceil(fround(fround(beyond) / step)), BOUNDS_STEPS) * step;
    const outer = (side, axis, at, most) => bounds.reduce((found, own) => most(found, own[at][axis]), side);
    return [
      low.map((side, axis) => side - margin(side - outer(side, axis, 0, Math.min))),
      high.map((side, axis) => side + margin(outer(side, axis, 1, Math.max) - side)),
    ];
  }

  /** Meshes of an object where a stance has it. */
  #pose(placed, stance) {
    const { object, firstMaterial } = placed;
    const draws = object.draws(stance.clip, stance.timeS);
    if (placed.local?.draws !== draws) placed.local = { draws, meshes: draws.map((draw) => localOf(object, draw, firstMaterial)) };
    const { meshes } = placed.local;
    if (placed.sizes !== null && !isSame(meshes.map(sizeOf), placed.sizes)) {
      throw refused(object.name, `has other meshes at ${stance.timeS} s than at rest`);
    }
    const rotation = rotationOf(stance.turnDeg);
    return meshes.map((mesh) => ({ ...mesh, vertices: movedBy(object, mesh.vertices, rotation, stance) }));
  }
}

/** A mesh in the object's own space, checked and interleaved. */
function localOf({ name, materials }, draw, firstMaterial) {
  const own = { ...draw, front: null, back: null, lightmapTexel: NONE };
  const problem = problemOf(own, { materials });
  if (problem !== null) throw refused(name, problem);
  const { material, triangles } = draw;
  return { material: material + firstMaterial, front: NO_BLOCK, back: NO_BLOCK, vertices: interleaved(own), triangles };
}

function sizeOf({ material, vertices, triangles }) {
  return [material, vertices.length, triangles.length];
}

/** Vertices scaled, turned and moved. */
function movedBy({ name }, vertices, r, { positionM, scale }) {
  const moved = vertices.slice();
  const turned = (at, row) => r[row] * vertices[at] + r[3 + row] * vertices[at + 1] + r[6 + row] * vertices[at + 2];
  for (let at = 0; at < vertices.length; at += VERTEX_NUMBERS) {
    for (let row = 0; row < 3; row++) {
      moved[at + POSITION + row] = positionM[row] + scale * turned(at + POSITION, row);
      moved[at + NORMAL + row] = turned(at + NORMAL, row);
      if (!Number.isFinite(moved[at + POSITION + row])) {
        throw refused(name, "stands where numbers end: its place or scale is too large");
      }
    }
  }
  return moved;
}

/** `R_y(yaw) · R_x(pitch) · R_z(roll)`, column after column. */
function rotationOf(turnDeg) {
  const [[sy, cy], [sx, cx], [sz, cz]] = turnDeg.map((angle) => [Math.sin(DEGREE * angle), Math.cos(DEGREE * angle)]);
  return [
    cy * cz + sy * sx * sz, cx * sz, -sy * cz + cy * sx * sz,
    -cy * sz + sy * sx * cz, cx * cz, sy * sz + cy * sx * cz,
    sy * cx, -sx, cy * cx,
  ];
}

function boundsOf(meshes) {
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (const { vertices } of meshes) {
    for (let at = 0; at < vertices.length; at += VERTEX_NUMBERS) {
      for (let axis = 0; axis < 3; axis++) {
        low[axis] = Math.min(low[axis], vertices[at + axis]);
        high[axis] = Math.max(high[axis], vertices[at + axis]);
      }
    }
  }
  return [low, high];
}

/** A stance with all its parts, as f32. Errs where it is no place. */
function stanceOf(given, index) {
  const { positionM, turnDeg, scale, clip, timeS } = { ...REST, ...given };
  const vectors = [positionM, turnDeg].map((vector) => Array.from(vector ?? [], fround));
  const stance = { positionM: vectors[0], turnDeg: vectors[1], scale: fround(scale), clip, timeS: fround(timeS) };
  const isVector = (vector) => vector.length === 3 && vector.every(Number.isFinite);
  const isPlace = vectors.every(isVector) && Number.isFinite(stance.scale) && stance.scale > 0 && Number.isFinite(stance.timeS);
  if (isPlace && Number.isInteger(clip) && clip >= 0) return stance;
  throw new Error(`stance ${index + 1} has a number that is not finite, or no scale above 0, or no number of an animation`);
}

/** A material whose textures come `first` later, and which is no emitter of the bake's. */
function shifted(material, first) {
  const later = (used) => used && { ...used, texture: used.texture + first };
  const { baseColourTexture, emissiveTexture, glass, normalMap, specular } = material;
  return {
    ...material,
    emitter: null,
    baseColourTexture: later(baseColourTexture),
    emissiveTexture: later(emissiveTexture),
    glass: glass && { ...glass, transmissionTexture: later(glass.transmissionTexture) },
    normalMap: normalMap && { ...normalMap, texture: later(normalMap.texture) },
    specular: specular && { ...specular, texture: later(specular.texture) },
  };
}

function refused(name, problem) {
  return new Error(`object '${name}': ${problem}`);
}
