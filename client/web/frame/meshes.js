// Meshes and textures of a scene on the device, shared by the shadow and the shade pass; twin of client/src/passes/meshes.rs.

import { colourTextures, numberTextures } from "../chunk/manifest.js";
import { COLOUR, LIGHTMAP_TEXEL, NORMAL, POSITION, UV, VERTEX_NUMBERS } from "../relight/draws.js";
import { FRAGMENT } from "./gpu.js";
import { NUMBERS, uploadTextures, whiteTexel } from "./textures.js";

const ADDRESS_MODES = { repeat: "repeat", clamp: "clamp-to-edge", mirror: "mirror-repeat" };

/** Layout of a vertex. */
export const VERTEX_LAYOUT = {
  arrayStride: 4 * VERTEX_NUMBERS,
  attributes: [
    { shaderLocation: 0, offset: 4 * POSITION, format: "float32x3" },
    { shaderLocation: 1, offset: 4 * NORMAL, format: "float32x3" },
    { shaderLocation: 2, offset: 4 * UV, format: "float32x2" },
    { shaderLocation: 3, offset: 4 * COLOUR, format: "float32x4" },
    { shaderLocation: 4, offset: 4 * LIGHTMAP_TEXEL, format: "float32x2" },
  ],
};

/** Kinds of binding of a texture and its sampler. */
export const SAMPLED = [
  { visibility: FRAGMENT, texture: { sampleType: "float" } },
  { visibility: FRAGMENT, sampler: { type: "filtering" } },
];

/** 2×3 map from uv to a texture's coordinates as two padded rows. */
export function uvRows(used) {
  const [first, second] = used?.transform ?? [[1, 0, 0], [0, 1, 0]];
  return [...first, 0, ...second, 0];
}

/** Meshes, textures and samplers. */
export class Meshes {
  #samplers = new Map();

  /** Uploads the meshes and textures of a scene. */
  static async create(gpu, { draws, textures, manifest }) {
    const meshes = new Meshes();
    meshes.meshes = draws.map((draw) => uploaded(gpu, draw));
    meshes.views = await uploadTextures(gpu, channelled(textures, manifest));
    meshes.white = whiteTexel(gpu);
    for (const u of Object.keys(ADDRESS_MODES)) {
      for (const v of Object.keys(ADDRESS_MODES)) {
        meshes.#samplers.set(u + v, sampler(gpu, u, v));
      }
    }
    return meshes;
  }

  /** These, and behind them what else a scene has, which is made on `gpu`. */
  async and(gpu, { draws, textures, manifest }) {
    const meshes = new Meshes();
    meshes.meshes = [...this.meshes, ...draws.slice(this.meshes.length).map((draw) => uploaded(gpu, draw))];
    meshes.views = [...this.views, ...(await uploadTextures(gpu, channelled(textures, manifest).slice(this.views.length)))];
    [meshes.white, meshes.#samplers] = [this.white, this.#samplers];
    return meshes;
  }

  /** Writes vertices and triangles of a mesh, which are as many as before. */
  set(gpu, index, { vertices, triangles }) {
    gpu.write(this.meshes[index].vertices, vertices);
    gpu.write(this.meshes[index].indices, triangles);
  }

  /** Texture and sampler of a use; white where there is none. */
  texture(used) {
    return used
      ? [this.views[used.texture], this.#samplers.get(used.wrap.join(""))]
      : [this.white, this.#samplers.get("clampclamp")];
  }

  /** Draws one mesh with the pipeline and groups that are bound. */
  draw(pass, mesh) {
    if (mesh.indexCount > 0) {
      pass.setVertexBuffer(0, mesh.vertices);
      pass.setIndexBuffer(mesh.indices, "uint32");
      pass.drawIndexed(mesh.indexCount);
    }
  }
}

/** Textures, those that materials read as linear numbers being marked so. Errs for one that is read as both. */
function channelled(textures, { materials }) {
  const named = (uses) => new Set(materials.flatMap((material) => uses(material).map((used) => used.texture)));
  const [colours, numbers] = [named(colourTextures), named(numberTextures)];
  return textures.map((file, index) => {
    if (!numbers.has(index)) return file;
    if (colours.has(index)) throw new Error(`texture ${index} is read as colours and as numbers`);
    return { ...file, channel: NUMBERS };
  });
}

function uploaded(gpu, { material, vertices, triangles }) {
  const buffers = {
    vertices: gpu.buffer("vertices", vertices.byteLength, GPUBufferUsage.VERTEX),
    indices: gpu.buffer("indices", triangles.byteLength, GPUBufferUsage.INDEX),
  };
  gpu.write(buffers.vertices, vertices);
  gpu.write(buffers.indices, triangles);
  return { ...buffers, indexCount: triangles.length, material };
}

function sampler(gpu, u, v) {
  return gpu.sampler({
    addressModeU: ADDRESS_MODES[u],
    addressModeV: ADDRESS_MODES[v],
    magFilter: "linear",
    minFilter: "linear",
    mipmapFilter: "linear",
  });
}
