// An object that stands and moves beside a bake: a glTF, or meshes of the caller's.
//
//   const chair = SceneObject.fromGlb("chair.glb", new Uint8Array(await file.arrayBuffer()));
//   await frame.setObjects([chair]);
//   frame.moveObject(0, { positionM: [1, 0, 0], timeS: 0.5 });

import { fround } from "../relight/numbers.js";
import { ObjectError } from "./error.js";
import { ObjectFile } from "./file.js";
import { plainMaterial } from "./materials.js";

export class SceneObject {
  // Meshes of the last animation and time asked for: most objects play nothing.
  #last = null;
  #drawsAt;

  constructor({ name, materials, textures, lengthsS, warnings, drawsAt }) {
    /** Length of each animation in seconds, and what of a file is not honoured. */
    Object.assign(this, { name, materials, textures, lengthsS, warnings });
    this.#drawsAt = drawsAt;
  }

  /** The object of a `.glb`, or of a `.gltf` with all bytes within. Errs, with what to do, for files that cannot be read. */
  static fromGlb(name, bytes) {
    try {
      const file = new ObjectFile(bytes);
      const { materials, images: textures, lengthsS, warnings } = file;
      const drawsAt = (clip, timeS) => file.draws(clip, timeS);
      return new SceneObject({ name, materials, textures, lengthsS, warnings, drawsAt });
    } catch (error) {
      throw error instanceof ObjectError ? new ObjectError(`object '${name}': ${error.message}`) : error;
    }
  }

  /**
   * The object of meshes `{material, positionM, normal, uv, colour, triangles}` in metres, with three, three, two, four and three numbers
   * each; uv and colour may be absent. Materials are as manifests state them (`chunk/manifest.js`), what is left out of them is plain;
   * textures are image files, `{mediaType, bytes}`.
   */
  static fromMeshes(name, { draws, materials = [{}], textures = [] }) {
    const own = draws.map(({ material = 0, positionM, normal, uv = [], colour = [], triangles }) => {
      const [positions, normals, uvs, colours] = [positionM, normal, uv, colour].map((values) => Float32Array.from(values));
      return { material, positionM: positions, normal: normals, uv: uvs, colour: colours, triangles: Uint32Array.from(triangles) };
    });
    const parts = { name, materials: materials.map(plainMaterial), textures, lengthsS: [], warnings: [] };
    return new SceneObject({ ...parts, drawsAt: () => own });
  }

  /** Meshes at a time of an animation, counted from 0, in the object's own space; the same list for the same time in a row. */
  draws(clip = 0, timeS = 0) {
    const clips = this.lengthsS.length;
    if (clip > 0 && clip >= clips) {
      throw new ObjectError(`object '${this.name}': animation ${clip + 1} is asked for, and it has ${clips}`);
    }
    // Without animations all times are one.
    const time = clips === 0 ? 0 : fround(timeS);
    if (this.#last?.clip !== clip || this.#last.time !== time) {
      this.#last = { clip, time, draws: this.#drawn(clips === 0 ? null : clip, time) };
    }
    return this.#last.draws;
  }

  #drawn(clip, time) {
    try {
      return this.#drawsAt(clip, time);
    } catch (error) {
      throw error instanceof ObjectError ? new ObjectError(`object '${this.name}': ${error.message}`) : error;
    }
  }
}
