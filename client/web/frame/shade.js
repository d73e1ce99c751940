// The picture's radiance on the device; twin of client/src/passes/shade/gpu.rs.

import { Glass } from "./glass.js";
import { FRAGMENT, VERTEX } from "./gpu.js";
import { SAMPLED, VERTEX_LAYOUT, uvRows } from "./meshes.js";
import { PanoramaPass } from "./panorama.js";
import { NEARER_WINS, TESTED_ALONE, clearedDepth } from "./targets.js";
import { VIEW_NUMBERS } from "./view.js";

// Bytes of a draw's look as the shader reads it.
const LOOK_BYTES = 224;
/** Feature of devices that blend 32-bit radiance; on others glass is drawn over 16-bit radiance. */
export const BLENDABLE = "float32-blendable";
// Textures of a material, each with its sampler.
const MATERIAL_TEXTURES = 5;
// Behind everything, without touching the depth.
const BEHIND = { ...NEARER_WINS, depthWriteEnabled: false, depthCompare: "always" };
// Glass, whose alpha is the share that it stops, over what is behind it.
const OVER = {
  color: { srcFactor: "src-alpha", dstFactor: "one-minus-src-alpha" },
  alpha: { srcFactor: "one", dstFactor: "one-minus-src-alpha" },
};

export class ShadePass {
  /** Null without a panorama. */
  panorama = null;

  /** Makes pipelines, and a target of `size` pixels. Frees all of it where that fails. */
  static async create(whole, scene, meshes, shadow, atlas, size) {
    const pass = new ShadePass();
    Object.assign(pass, { gpu: whole.branch(), scene, meshes, shadow });
    try {
      await pass.#make(atlas, size);
    } catch (error) {
      pass.destroy();
      throw error;
    }
    return pass;
  }

  /** Frees all buffers and textures. */
  destroy() {
    this.panorama?.destroy();
    this.gpu.destroy();
  }

  async #make(atlas, size) {
    const { gpu, scene, shadow } = this;
    this.glass = new Glass(scene);
    const is32 = this.glass.panes.length === 0 || gpu.device.features.has(BLENDABLE);
    this.format = is32 ? "rgba32float" : "rgba16float";
    const looks = { visibility: VERTEX | FRAGMENT, buffer: { type: "uniform", hasDynamicOffset: true } };
    const layouts = {
      view: gpu.bindLayout([
        { visibility: VERTEX | FRAGMENT, buffer: { type: "uniform" } },
        { visibility: FRAGMENT, texture: { sampleType: "unfilterable-float", viewDimension: "2d-array" } },
        { visibility: FRAGMENT, buffer: { type: "read-only-storage" } },
      ]),
      draws: gpu.bindLayout([looks]),
      material: gpu.bindLayout(Array(MATERIAL_TEXTURES).fill(SAMPLED).flat()),
    };
    this.#bind(layouts, atlas);
    const all = [shadow.lightLayout, layouts.view, layouts.draws, layouts.material];
    await this.#makePipelines(gpu.pipelineLayout(all));
    this.resize(size);
  }

  #bind(layouts, atlas) {
    const { gpu, scene, meshes } = this;
    const { draws, layout, manifest } = scene;
    const placements = draws.flatMap(({ front, back }) => [...layout.placement(front), ...layout.placement(back)]);
    this.view = gpu.buffer("view", 4 * VIEW_NUMBERS, GPUBufferUsage.UNIFORM);
    this.placements = gpu.storage("placements", Uint32Array.from(placements));
    this.viewLayout = layouts.view;
    this.setPages(atlas);
    this.looks = gpu.uniforms("draws", LOOK_BYTES, draws.length);
    this.draws = gpu.bind(layouts.draws, [{ buffer: this.looks.buffer, size: LOOK_BYTES }]);
    this.materials = manifest.materials.map((material) => {
      return gpu.bind(layouts.material, boundTextures(material).flatMap((texture) => meshes.texture(texture)));
    });
    this.paneCorners = gpu.buffer("corners of glass", 12 * this.glass.panes.length, GPUBufferUsage.INDEX);
  }

  async #makePipelines(layout) {
    const blend = this.glass.panes.length > 0 ? OVER : null;
    const sides = (depth, over) => {
      const made = ["back", "none"].map((cull) => this.#pipeline(layout, ["corner", "shade"], cull, depth, over));
      return Promise.all(made);
    };
    this.opaque = await sides(NEARER_WINS, null);
    this.overlaid = blend && (await sides(TESTED_ALONE, blend));
    this.sky = await this.#pipeline(layout, ["sky_corner", "sky"], "none", BEHIND, null);
  }

  #pipeline(layout, [vertex, fragment], cullMode, depthStencil, blend) {
    const module = this.gpu.module("shade");
    const constants = fragment === "shade" ? detailsOf(this.scene.manifest) : {};
    const target = blend ? { format: this.format, blend } : { format: this.format };
    return this.gpu.render({
      label: fragment,
      layout,
      vertex: { module, entryPoint: vertex, buffers: vertex === "corner" ? [VERTEX_LAYOUT] : [] },
      primitive: { topology: "triangle-list", cullMode },
      depthStencil,
      fragment: { module, entryPoint: fragment, targets: [target], constants },
    });
  }

  /** Takes other pages of indirect light. */
  setPages(atlas) {
    this.viewGroup = this.gpu.bind(this.viewLayout, [this.view, atlas.view, this.placements]);
  }

  /** Puts a panorama behind the scene, turned and scaled, or none; another one makes a texture. Errs, and keeps the former, where it cannot be. */
  async setPanorama(panorama, turnDeg, strength) {
    const before = this.panorama;
    if (before?.panorama === panorama) {
      before?.set(turnDeg, strength);
      return;
    }
    const { gpu, view, format } = this;
    const made = panorama && (await PanoramaPass.create(gpu, panorama, view, { format, depthStencil: BEHIND }));
    made?.set(turnDeg, strength);
    this.panorama = made;
    before?.destroy();
  }

  /** Makes a target of another size: width and height in pixels. */
  resize(size) {
    [this.target, this.depth].forEach((texture) => this.gpu.free(texture));
    this.size = size;
    const usage = GPUTextureUsage.RENDER_ATTACHMENT;
    const read = GPUTextureUsage.COPY_SRC | GPUTextureUsage.TEXTURE_BINDING;
    this.target = this.gpu.texture({ label: "picture", size, format: this.format, usage: usage | read });
    this.depth = this.gpu.texture({ label: "depth", size, format: NEARER_WINS.format, usage });
    this.targetView = this.target.createView();
    this.depthView = this.depth.createView();
  }

  /** Moves a mesh: its vertices and triangles, which are as many as before. */
  moveMesh(index, mesh) {
    this.meshes.set(this.gpu, index, mesh);
    this.glass.set(index, mesh);
  }

  /** Writes looks of materials under other colours; the emitters' scale is 1 where absent. */
  setLooks(tints, emitterScale) {
    const { draws, manifest } = this.scene;
    const looks = draws.map(({ material }, index) => {
      const own = { ...manifest.materials[material], baseColour: tints.baseColour(this.scene, material) };
      return lookOf(own, index, emitterScale);
    });
    this.gpu.writeStrided(this.looks, looks);
  }

  /** Records one sample per pixel of a view. */
  record(encoder, { matrix, numbers }) {
    this.gpu.write(this.view, numbers);
    const pass = encoder.beginRenderPass({
      label: "shade",
      colorAttachments: [
        { view: this.targetView, clearValue: [0, 0, 0, 0], loadOp: "clear", storeOp: "store" },
      ],
      depthStencilAttachment: clearedDepth(this.depthView),
    });
    this.panorama?.record(pass);
    pass.setBindGroup(0, this.shadow.lightGroup);
    pass.setBindGroup(1, this.viewGroup);
    if (this.panorama === null && this.materials.length > 0) {
      // The sky reads neither, but its pipeline's layout names them.
      pass.setBindGroup(2, this.draws, [0]);
      pass.setBindGroup(3, this.materials[0]);
      pass.setPipeline(this.sky);
      pass.draw(3);
    }
    this.meshes.meshes.forEach((mesh, index) => {
      if (!this.scene.manifest.materials[mesh.material].glass) {
        this.#bindDraw(pass, this.opaque, index);
        this.meshes.draw(pass, mesh);
      }
    });
    if (this.overlaid) {
      this.#drawGlass(pass, matrix);
    }
    pass.end();
  }

  #drawGlass(pass, matrix) {
    const { corners, runs } = this.glass.farthestFirst(matrix);
    this.gpu.write(this.paneCorners, corners);
    pass.setIndexBuffer(this.paneCorners, "uint32");
    for (const { draw, from, to } of runs) {
      this.#bindDraw(pass, this.overlaid, draw);
      pass.setVertexBuffer(0, this.meshes.meshes[draw].vertices);
      pass.drawIndexed(3 * (to - from), 1, 3 * from);
    }
  }

  #bindDraw(pass, [single, double], index) {
    const { material } = this.meshes.meshes[index];
    pass.setPipeline(this.scene.manifest.materials[material].doubleSided ? double : single);
    pass.setBindGroup(2, this.draws, [index * this.looks.stride]);
    pass.setBindGroup(3, this.materials[material]);
  }
}

/** Overrides of the shader: it holds maps and gloss only where a material of the scene, or of its objects, has such. */
function detailsOf({ materials }) {
  return {
    HAS_MAPS: Number(materials.some(({ normalMap }) => normalMap)),
    HAS_GLOSS: Number(materials.some(({ specular }) => specular)),
  };
}

/** Textures of a material in the order of their bindings. */
function boundTextures({ baseColourTexture, emissiveTexture, glass, normalMap, specular }) {
  return [baseColourTexture, emissiveTexture, glass?.transmissionTexture, normalMap?.texture, specular?.texture];
}

/** Look of a draw as the shader reads it. */
function lookOf(material, index, emitterScale) {
  const { baseColour, emissive, emitter, glass, normalMap, specular, alphaCutoff } = material;
  const scale = emitterScale[emitter] ?? 1;
  const rows = boundTextures(material).flatMap(uvRows);
  const look = new Float32Array(LOOK_BYTES / 4);
  look.set([...baseColour, ...emissive.map((channel) => channel * scale), 0, ...rows]);
  const details = [normalMap?.scale ?? 0, normalMap ? 1 : 0, specular?.metallic ?? 0, specular?.roughness ?? -1];
  look.set([alphaCutoff ?? -1, 0, glass?.transmission ?? 0, glass?.blends ? 1 : 0, ...details], 48);
  new Uint32Array(look.buffer)[49] = index;
  return look;
}
