// Mesh primitives to plain triangles in their own space: any triangle mode, indexed or not, unused vertices left out; twin of
// worker/src/scene/primitives.rs.

import { fround } from "../relight/numbers.js";
import { Accessor } from "./accessor.js";
import { listOf, part } from "./document.js";
import { ObjectError, broken } from "./error.js";
import { LIMITS, within } from "./limits.js";

// Modes by glTF's numbers.
const TRIANGLES = 4;
const STRIP = 5;
const FAN = 6;
const MODES = 6;
// Sets of joints that pull at a vertex.
const SETS = ["0", "1"];

/** Name in messages of a primitive. */
export function primitivePlace(document, mesh, index) {
  return `${document.place("mesh", mesh)} primitive ${index}`;
}

/** A primitive of a file, of which each time of an animation may ask for another shape. */
export class Primitive {
  // Positions and normals without morph targets, once read.
  #still = null;
  // Accessors of morph targets by attribute and number, once opened: each opening is paid for.
  #opened = new Map();

  /** Reads all but places; null where it has no triangles. */
  static open(document, budgets, mesh, index, warn) {
    const stated = listOf(document.list("mesh")[mesh], "primitives", () => document.place("mesh", mesh))[index];
    const place = () => primitivePlace(document, mesh, index);
    if (typeof stated !== "object" || stated === null) throw broken(place(), "it is no object");
    const mode = stated.mode ?? TRIANGLES;
    if (!Number.isInteger(mode) || mode < 0 || mode > MODES) throw broken(place(), "its mode is not one of glTF's");
    const attributes = part(stated, "attributes", place) ?? {};
    if (mode < TRIANGLES || attributes.POSITION === undefined) {
      warn(`${place()} has no ${mode < TRIANGLES ? "triangles" : "positions"} and is not shown`);
      return null;
    }
    const compressed = Object.keys(stated.extensions ?? {}).find((name) => /draco/.test(name));
    if (compressed) {
      throw new ObjectError(`${place()} is compressed (${compressed}): convert it with 'npx @gltf-transform/cli copy IN.glb OUT.glb'`);
    }
    const primitive = new Primitive();
    Object.assign(primitive, { document, budgets, stated, attributes, place, material: stated.material });
    primitive.targets = listOf(stated, "targets", place);
    primitive.#read(mode);
    return primitive;
  }

  #open(index, name, types, minCount, isNormalized = false) {
    const place = () => `${name} of ${this.place()}`;
    return new Accessor(this.document, this.budgets, index, { types, minCount, isNormalized }, place);
  }

  #read(mode) {
    const { stated, attributes } = this;
    this.positions = this.#open(attributes.POSITION, "POSITION", ["VEC3"], 0);
    this.count = this.positions.count;
    const indices = stated.indices === undefined ? null : this.#open(stated.indices, "indices", ["SCALAR"], 0);
    if (indices !== null && !indices.isUnsigned) throw broken(this.place(), "its indices are not unsigned integers");
    const corners = indices?.count ?? this.count;
    const triangles = mode === TRIANGLES ? Math.floor(corners / 3) : Math.max(corners - 2, 0);
    within(LIMITS.triangles, triangles);
    // The table of used vertices is as long as the highest index.
    within(LIMITS.vertices, this.count);
    this.#compact(mode, triangles, indices);
    this.normals = attributes.NORMAL === undefined ? null : this.#open(attributes.NORMAL, "NORMAL", ["VEC3"], this.count);
    this.uvs = SETS.map((set) => this.#readUvs(set));
    this.colours = this.#readColours();
    this.influences = this.#readInfluences();
  }

  /** Triangles over a compacted vertex list in order of first use, and for each of its vertices where the file has it. */
  #compact(mode, count, indices) {
    const compactOf = new Uint32Array(this.count);
    const vertices = [];
    this.triangles = new Uint32Array(3 * count);
    for (let corner = 0; corner < 3 * count; corner++) {
      const position = cornerOf(mode, Math.floor(corner / 3), corner % 3);
      const vertex = indices === null ? position : indices.unsigned(position);
      if (vertex >= this.count) {
        const problem = `index ${position} is ${vertex}, but the primitive has ${this.count} vertices`;
        throw broken(this.place(), problem);
      }
      // 0 marks a vertex that no triangle has used yet.
      if (compactOf[vertex] === 0) compactOf[vertex] = vertices.push(vertex);
      this.triangles[corner] = compactOf[vertex] - 1;
    }
    this.vertices = Uint32Array.from(vertices);
  }

  /** Places and normals in the shape that weights of morph targets give; normals are null where the file has none. */
  shape(weights) {
    const isStill = this.targets.length === 0 || !weights.some((weight) => weight !== 0 && Number.isFinite(weight));
    if (isStill && this.#still !== null) return this.#still;
    const positions = this.#displaced(this.positions, "POSITION", weights);
    const bad = positions.findIndex((value) => !Number.isFinite(value));
    if (bad >= 0) {
      const vertex = this.vertices[Math.floor(bad / 3)];
      const remedy = "repair the mesh and export again";
      throw new ObjectError(`${this.place()}: the position of vertex ${vertex} is not finite; ${remedy}`);
    }
    const normals = this.normals && this.#displaced(this.normals, "NORMAL", weights);
    const shape = { positions, normals };
    if (isStill) this.#still = shape;
    return shape;
  }

  /** An attribute under morph targets: `base + Σ w · displacement`. */
  #displaced(base, attribute, weights) {
    const moved = this.targets.flatMap((target, at) => {
      const weight = weights[at] ?? 0;
      const index = target?.[attribute];
      if (index === undefined || weight === 0 || !Number.isFinite(weight)) return [];
      return [{ weight, target: this.#target(index, attribute, at) }];
    });
    const values = gathered(base, this.vertices, 3, 0);
    const by = new Float32Array(3);
    this.vertices.forEach((vertex, at) => {
      for (const { weight, target } of moved) {
        target.read(vertex, by, 0, 3);
        for (let axis = 0; axis < 3; axis++) values[3 * at + axis] += fround(by[axis] * weight);
      }
    });
    return values;
  }

  #target(index, attribute, at) {
    const key = `${attribute} ${at}`;
    if (!this.#opened.has(key)) {
      this.#opened.set(key, this.#open(index, `morph target ${attribute}`, ["VEC3"], this.count));
    }
    return this.#opened.get(key);
  }

  #readUvs(set) {
    const index = this.attributes[`TEXCOORD_${set}`];
    if (index === undefined) return null;
    const uvs = gathered(this.#open(index, `TEXCOORD_${set}`, ["VEC2"], this.count), this.vertices, 2, 0);
    for (let at = 0; at < uvs.length; at += 2) {
      if (!Number.isFinite(uvs[at]) || !Number.isFinite(uvs[at + 1])) uvs.fill(0, at, at + 2);
    }
    return uvs;
  }

  #readColours() {
    const index = this.attributes.COLOR_0;
    if (index === undefined) return null;
    // Integer colours are always fractions in glTF; exporters forget the flag.
    const colours = gathered(this.#open(index, "COLOR_0", ["VEC3", "VEC4"], this.count, true), this.vertices, 4, 1);
    return colours.map((channel) => (Number.isNaN(channel) ? 0 : Math.min(Math.max(channel, 0), 1)));
  }

  #readInfluences() {
    const sets = [];
    for (const set of SETS) {
      const [joints, weights] = [this.attributes[`JOINTS_${set}`], this.attributes[`WEIGHTS_${set}`]];
      if (joints === undefined || weights === undefined) break;
      sets.push({
        joints: gathered(this.#open(joints, "JOINTS", ["VEC4"], this.count), this.vertices, 4, 0),
        weights: gathered(this.#open(weights, "WEIGHTS", ["VEC4"], this.count, true), this.vertices, 4, 0),
      });
    }
    return sets;
  }
}

/** Which corner of the list is a corner of triangle `index`, counter-clockwise (glTF 2.0 §3.7.2.1). */
function cornerOf(mode, index, corner) {
  if (mode === STRIP) return index + [0, 1 + (index % 2), 2 - (index % 2)][corner];
  if (mode === FAN) return corner === 2 ? 0 : index + corner + 1;
  return 3 * index + corner;
}

function gathered(accessor, vertices, width, missing) {
  const values = new Float32Array(width * vertices.length);
  vertices.forEach((vertex, at) => accessor.read(vertex, values, width * at, width, missing));
  return values;
}
