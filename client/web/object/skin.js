// Meshes whose vertices follow the joints of a skin; twin of worker/src/scene/pose.rs.

import { Accessor } from "./accessor.js";
import { IDENTITY, after, determinant, isFinite32, normalMatrix, ofMatrix } from "./affine.js";
import { listOf } from "./document.js";
import { ObjectError, broken } from "./error.js";

export class Skin {
  /** Joints of a skin that a node names, and their inverse bind matrices. */
  constructor(document, budgets, index, place) {
    const stated = document.get("skin", index, place);
    this.place = () => document.place("skin", index);
    this.joints = listOf(stated, "joints", this.place);
    this.joints.forEach((joint) => document.get("node", joint, this.place));
    const bound = stated.inverseBindMatrices;
    this.binds = bound === undefined ? null : this.#open(document, budgets, bound);
  }

  #open(document, budgets, index) {
    const place = () => `inverse bind matrices of ${this.place()}`;
    const wanted = { types: ["MAT4"], minCount: this.joints.length };
    const matrices = new Accessor(document, budgets, index, wanted, place);
    return this.joints.map((_, slot) => {
      const columns = new Float32Array(16);
      matrices.read(slot, columns, 0, 16);
      return ofMatrix([...columns]);
    });
  }

  /** Of each joint the map of what is bound to it: `W_j · B_j` with the joint's node W and its inverse bind matrix B. */
  maps(worldOf) {
    return this.joints.map((joint, slot) => {
      const map = after(worldOf(joint), this.binds?.[slot] ?? IDENTITY);
      if (!isFinite32(map)) throw broken(`joint ${slot} of ${this.place()}`, "the transform is not finite");
      return map;
    });
  }
}

/**
 * A shape whose vertices are each moved by the weighted mean of their joints' maps, and whether that mirrors it. Errs on vertices that
 * name joints which the skin does not have.
 */
export function bent({ positions, normals }, influences, maps, place) {
  const own = { positions: new Float32Array(positions.length), normals: normals && new Float32Array(normals.length) };
  let isMirrored = false;
  for (let vertex = 0; vertex < positions.length / 3; vertex++) {
    const m = vertexMap(influences, maps, vertex, place);
    const at = 3 * vertex;
    const [x, y, z] = positions.subarray(at, at + 3);
    own.positions.set([0, 1, 2].map((row) => m[row] * x + m[3 + row] * y + m[6 + row] * z + m[9 + row]), at);
    isMirrored ||= determinant(m) < 0;
    if (normals !== null) {
      const n = normalMatrix(m);
      const [nx, ny, nz] = normals.subarray(at, at + 3);
      const turned = [0, 1, 2].map((row) => n[row] * nx + n[3 + row] * ny + n[6 + row] * nz);
      const length = Math.hypot(...turned);
      own.normals.set(length > 0 ? turned.map((value) => value / length) : [nx, ny, nz], at);
    }
  }
  return { shape: own, isMirrored };
}

/** `Σ w_j M_j / Σ w_j`; the first joint's map where no weight is above 0. */
function vertexMap(influences, maps, vertex, place) {
  const sum = new Array(12).fill(0);
  let total = 0;
  const mapOf = (joint) => {
    if (joint < maps.length) return maps[joint];
    throw new ObjectError(
      `${place()}: vertex ${vertex} names joint ${joint}, but the skin has ${maps.length}; export the file again`,
    );
  };
  for (const { joints, weights } of influences) {
    for (let at = 4 * vertex; at < 4 * vertex + 4; at++) {
      if (!(weights[at] > 0)) continue;
      // Files may name joints by numbers that are none; as whole numbers without a sign those below 0 are the first.
      const map = mapOf(Math.max(Math.trunc(joints[at]) || 0, 0));
      map.forEach((value, index) => (sum[index] += value * weights[at]));
      total += weights[at];
    }
  }
  return total > 0 ? sum.map((value) => value / total) : mapOf(0);
}
