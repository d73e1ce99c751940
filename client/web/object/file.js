// A glTF whose meshes are read at any time of its animations; twin of worker/src/scene/moving.rs and nodes.rs.

import { fround } from "../relight/numbers.js";
import { IDENTITY, after, isFinite32, ofMatrix, ofParts } from "./affine.js";
import { lengthsOf, openClip } from "./animation.js";
import { GltfDocument, listOf, numbers } from "./document.js";
import { ObjectError, broken } from "./error.js";
import { Budgets, LIMITS, within } from "./limits.js";
import { MaterialTable } from "./materials.js";
import { isMirrored, placed } from "./placement.js";
import { Primitive } from "./primitive.js";
import { Skin, bent } from "./skin.js";

// Most warnings that are kept.
const WARNINGS_MAX = 32;

export class ObjectFile {
  /** What of the file is not honoured. */
  warnings = [];
  #clips = new Map();
  #primitives = new Map();
  #skins = new Map();
  // The nodes of the scene, parents before their children, `{index, parent}`, and meshes to draw, `{node, primitive, …}`.
  #nodes = [];
  #instances = [];

  /** Reads the bytes of a file; errs where it is none, or has more than the limits. */
  constructor(bytes) {
    const warn = (words) => this.warnings.length < WARNINGS_MAX && this.warnings.push(words);
    this.document = new GltfDocument(bytes);
    this.budgets = new Budgets(bytes.length);
    this.table = new MaterialTable(this.document, this.budgets, warn);
    within(LIMITS.nodes, this.document.list("node").length);
    this.parents = this.#parentsOf();
    this.#walk(warn);
    this.lengthsS = lengthsOf(this.document, this.budgets);
    this.materials = this.table.materials;
    this.images = this.table.images;
    if (this.#instances.some(({ material }) => this.materials[material].emissive.some((channel) => channel > 0))) {
      warn("it has materials that emit: they are drawn bright, and light nothing");
    }
  }

  /** Meshes at a time of an animation, an f32 in seconds; at rest without one. They are as many, and as large, at all times. */
  draws(clip, timeS) {
    const posed = this.#posed(clip, timeS);
    const maps = new Map();
    for (const { index, parent } of this.#nodes) {
      const map = after(parent === null ? IDENTITY : maps.get(parent), localMap(this.document, index, posed.get(index)));
      if (!isFinite32(map)) throw broken(this.document.place("node", index), "the transform is not finite");
      maps.set(index, map);
    }
    return this.#instances.map((instance) => this.#draw(instance, maps, posed));
  }

  /** Places, turns, scales and weights of nodes that an animation moves. */
  #posed(clip, timeS) {
    const posed = new Map();
    if (clip === null) return posed;
    if (!this.#clips.has(clip)) this.#clips.set(clip, openClip(this.document, this.budgets, clip));
    for (const { node, path, keys } of this.#clips.get(clip)) {
      const value = keys.at(timeS);
      if (!value.every(Number.isFinite)) {
        throw broken(`${this.document.place("node", node)} at ${timeS} s`, "the transform is not finite");
      }
      posed.set(node, { ...posed.get(node), [path]: value });
    }
    return posed;
  }

  #parentsOf() {
    const parents = new Map();
    this.document.list("node").forEach((node, parent) => {
      for (const child of listOf(node, "children", () => this.document.place("node", parent))) {
        if (!parents.has(child)) parents.set(child, parent);
      }
    });
    return parents;
  }

  /** The root nodes of the default scene, else of the first, else all nodes without a parent. */
  #roots() {
    const { document } = this;
    const file = () => "the file";
    const { scene } = document.root;
    const chosen = scene === undefined ? document.list("scene")[0] : document.get("scene", scene, file);
    if (chosen !== undefined) return listOf(chosen, "nodes", () => "the scene");
    const roots = [...document.list("node").keys()].filter((node) => !this.parents.has(node));
    if (roots.length === 0 && document.list("node").length > 0) throw twice(document, 0);
    return roots;
  }

  #walk(warn) {
    const { document } = this;
    const reached = new Set();
    // A list of its own instead of recursion: depth then costs no stack.
    const pending = this.#roots().map((index) => ({ index, parent: null, depth: 1 })).reverse();
    while (pending.length > 0) {
      const here = pending.pop();
      const node = document.get("node", here.index, () => "the scene");
      within(LIMITS.nodeLevels, here.depth);
      if (reached.has(here.index)) throw twice(document, here.index);
      reached.add(here.index);
      this.#nodes.push(here);
      if (node.mesh !== undefined) this.#addMesh(node, here.index, warn);
      const children = listOf(node, "children", () => document.place("node", here.index));
      for (const index of [...children].reverse()) pending.push({ index, parent: here.index, depth: here.depth + 1 });
    }
  }

  #addMesh(node, index, warn) {
    const { document, budgets } = this;
    const place = () => document.place("node", index);
    const mesh = document.get("mesh", node.mesh, place);
    const skin = node.skin === undefined ? null : this.#skin(node.skin, place);
    listOf(mesh, "primitives", () => document.place("mesh", node.mesh)).forEach((_, at) => {
      budgets.spend(LIMITS.instances, 1);
      const primitive = this.#primitive(node.mesh, at, warn);
      if (primitive === null || primitive.triangles.length === 0) return;
      const isFlat = primitive.normals === null;
      budgets.spend(LIMITS.triangles, primitive.triangles.length / 3);
      budgets.spend(LIMITS.vertices, isFlat ? primitive.triangles.length : primitive.vertices.length);
      const material = this.table.indexOf(primitive.material, primitive.place);
      const under = () => `${primitive.place()} under ${place()}`;
      const bends = skin !== null && primitive.influences.length > 0;
      const still = stillOf(primitive, this.table.uvsOf(material), isFlat);
      this.#instances.push({ node: index, primitive, material, skin: bends ? skin : null, place: under, ...still });
    });
  }

  #primitive(mesh, at, warn) {
    const key = `${mesh} ${at}`;
    if (!this.#primitives.has(key)) {
      this.#primitives.set(key, Primitive.open(this.document, this.budgets, mesh, at, warn));
    }
    return this.#primitives.get(key);
  }

  #skin(index, place) {
    if (!this.#skins.has(index)) this.#skins.set(index, new Skin(this.document, this.budgets, index, place));
    return this.#skins.get(index);
  }

  #draw(instance, maps, posed) {
    const { node, primitive, skin, place, material, uv, colour } = instance;
    let shape = primitive.shape(this.#weights(node, posed));
    let map = maps.get(node);
    let mirrored = isMirrored(map);
    if (skin !== null) {
      const worldOf = (joint) => this.#worldOf(joint, posed);
      const own = bent(shape, primitive.influences, skin.maps(worldOf), place);
      // Joints alone say where a skinned mesh is.
      [shape, mirrored, map] = [own.shape, own.isMirrored, IDENTITY];
    }
    const wound = mirrored ? (instance.mirrored ??= swapped(primitive.triangles)) : primitive.triangles;
    const { positions, normals } = placed(shape, wound, map, place);
    const triangles = primitive.normals === null ? instance.triangles : wound;
    const gathered = primitive.normals === null && mirrored;
    return {
      material,
      positionM: positions,
      normal: normals,
      uv: gathered ? cornersSwapped(uv, 2) : uv,
      colour: gathered ? cornersSwapped(colour, 4) : colour,
      triangles,
    };
  }

  #weights(node, posed) {
    const stated = this.document.list("node")[node];
    const place = () => this.document.place("node", node);
    const own = posed.get(node)?.weights ?? numbers(stated, "weights", null, place, null);
    return own ?? numbers(this.document.list("mesh")[stated.mesh], "weights", null, place, []);
  }

  /** A node's place by its parents, also outside the scene. */
  #worldOf(node, posed) {
    let map = localMap(this.document, node, posed.get(node));
    let here = node;
    for (let level = 0; level < LIMITS.nodeLevels.limit; level++) {
      here = this.parents.get(here);
      if (here === undefined) return map;
      map = after(localMap(this.document, here, posed.get(here)), map);
    }
    throw twice(this.document, node);
  }
}

function twice(document, node) {
  return broken(document.place("node", node), "it is reached twice in the scene: nodes must form trees");
}

/** A node's own map, where an animation may have moved it. */
function localMap(document, index, posed = {}) {
  const node = document.list("node")[index];
  const place = () => document.place("node", index);
  const matrix = numbers(node, "matrix", 16, place, null);
  if (matrix !== null) return ofMatrix(matrix);
  return ofParts(
    posed.translation ?? numbers(node, "translation", 3, place, [0, 0, 0]),
    posed.rotation ?? numbers(node, "rotation", 4, place, [0, 0, 0, 1]),
    posed.scale ?? numbers(node, "scale", 3, place, [1, 1, 1]),
  );
}

/** Texture coordinates and colours of a primitive, and triangles of its own vertices where it has no normals: the same at all times. */
function stillOf({ uvs, colours, triangles, vertices }, { set, transform }, isFlat) {
  const spread = (values, width) => (isFlat ? cornersOf(values, triangles, width) : values);
  const own = set === null ? null : (uvs[set] ?? new Float32Array(2 * vertices.length));
  return {
    uv: own === null ? new Float32Array(0) : spread(transformed(own, transform), 2),
    colour: colours === null ? new Float32Array(0) : spread(colours, 4),
    triangles: isFlat ? Uint32Array.from(triangles.keys()) : triangles,
  };
}

function transformed(uvs, rows) {
  if (rows === null) return uvs;
  const own = new Float32Array(uvs.length);
  for (let at = 0; at < uvs.length; at += 2) {
    rows.forEach(([a, b, c], row) => (own[at + row] = fround(fround(fround(a * uvs[at]) + fround(b * uvs[at + 1])) + c)));
  }
  return own;
}

function cornersOf(values, triangles, width) {
  const own = new Float32Array(width * triangles.length);
  triangles.forEach((vertex, corner) => own.set(values.subarray(width * vertex, width * vertex + width), width * corner));
  return own;
}

/** Triangles that are seen from the other side. */
function swapped(triangles) {
  const own = triangles.slice();
  for (let first = 0; first < own.length; first += 3) [own[first + 1], own[first + 2]] = [own[first + 2], own[first + 1]];
  return own;
}

/** Values of vertices, three for each triangle, of which the second and third are exchanged. */
function cornersSwapped(values, width) {
  const order = swapped(Uint32Array.from({ length: values.length / width }, (_, corner) => corner));
  return cornersOf(values, order, width);
}
