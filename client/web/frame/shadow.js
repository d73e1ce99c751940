// Shadow maps on the device, and the bind group of lights that other passes read them by; twin of client/src/passes/shadow/gpu.rs.

import { COMPUTE, FRAGMENT, VERTEX } from "./gpu.js";
import { SAMPLED, VERTEX_LAYOUT, uvRows } from "./meshes.js";
import { PaneMaps } from "./pane_maps.js";
import { FACE_BYTES, LIGHT_BYTES } from "./plan.js";
import { NEARER_WINS, arrayView, clearedDepth, createMaps, faceView } from "./targets.js";

const MATRIX_BYTES = 64;

export class ShadowPass {
  /** Makes room for lights and their maps; there are none until `set`, and nothing casts until `take`. */
  static async create(gpu, room) {
    const shadow = new ShadowPass();
    shadow.gpu = gpu;
    const faceLayout = gpu.bindLayout([
      { visibility: VERTEX, buffer: { type: "uniform", hasDynamicOffset: true } },
    ]);
    shadow.maskLayout = gpu.bindLayout([{ visibility: VERTEX | FRAGMENT, buffer: { type: "uniform" } }, ...SAMPLED]);
    shadow.solid = await pipeline(gpu, [faceLayout], "solid", null);
    shadow.masked = await pipeline(gpu, [faceLayout, shadow.maskLayout], "masked", "mask");
    shadow.projections = gpu.uniforms("faces", MATRIX_BYTES, room.faces);
    shadow.faceGroup = gpu.bind(faceLayout, [{ buffer: shadow.projections.buffer, size: MATRIX_BYTES }]);
    shadow.maps = createMaps(gpu, room.side, room.faces, "depth32float");
    shadow.faceViews = Array.from({ length: room.faces }, (_, layer) => faceView(shadow.maps, layer));
    shadow.panes = await PaneMaps.create(gpu, room, faceLayout);
    shadow.#makeLights(room);
    return shadow;
  }

  /** Meshes of a scene with their masks and glass, made on `gpu`; with maps for the first glass. They are to be taken, or dropped. */
  castersOf(gpu, scene, meshes) {
    const masks = meshes.meshes.map(({ material }) => {
      return maskGroup(gpu, meshes, this.maskLayout, scene.manifest.materials[material]);
    });
    const panes = this.panes.groupsOf(gpu, scene, meshes);
    return { meshes, masks, panes, hasGlass: panes.some((pane) => pane !== null), paneMaps: this.panes.mapsFor(panes) };
  }

  /** Draws other meshes from here on; `set` is to follow. */
  take(casters) {
    this.casters = casters;
    if (casters.paneMaps === null) return;
    this.panes.take(casters.paneMaps);
    this.#bindLights();
  }

  /** Frees maps of meshes that are not taken. */
  drop({ paneMaps }) {
    if (paneMaps !== null) this.panes.free(paneMaps);
  }

  #makeLights(room) {
    const { gpu } = this;
    this.lights = gpu.blank("lights", LIGHT_BYTES * room.lights);
    this.faces = gpu.blank("faces", FACE_BYTES * room.faces);
    this.count = gpu.uniform("light count", new Uint32Array(4));
    const rows = { type: "read-only-storage" };
    const depth = { sampleType: "depth", viewDimension: "2d-array" };
    const kinds = [
      { buffer: rows },
      { buffer: rows },
      { buffer: { type: "uniform" } },
      { texture: depth },
      { texture: depth },
      { texture: { sampleType: "unfilterable-float", viewDimension: "2d-array" } },
    ];
    this.lightLayout = gpu.bindLayout(kinds.map((kind) => ({ visibility: COMPUTE | FRAGMENT, ...kind })));
    this.#bindLights();
  }

  /** Group 0 of the shaders that read lights. */
  #bindLights() {
    const { gpu, panes } = this;
    const maps = [this.maps, panes.depthMaps, panes.passedMaps].map(arrayView);
    this.lightGroup = gpu.bind(this.lightLayout, [this.lights, this.faces, this.count, ...maps]);
  }

  /** Writes the lights and faces of a plan within the room. */
  set(plan) {
    this.gpu.writeStrided(this.projections, plan.faces.map(({ matrix }) => Float32Array.from(matrix)));
    this.gpu.write(this.lights, plan.lightBytes());
    this.gpu.write(this.faces, plan.faceNumbers(this.casters.hasGlass));
    this.gpu.write(this.count, plan.countBytes());
  }

  /** Records faces of the plan that was set last, from one to before another: every mesh into each, then its glass. */
  record(encoder, from, to) {
    const { meshes, masks, panes } = this.casters;
    for (let face = from; face < to; face++) {
      const view = this.faceViews[face];
      const offset = [face * this.projections.stride];
      const pass = encoder.beginRenderPass({
        label: "shadow",
        colorAttachments: [],
        depthStencilAttachment: clearedDepth(view),
      });
      pass.setBindGroup(0, this.faceGroup, offset);
      meshes.meshes.forEach((mesh, index) => {
        if (panes[index] !== null) return;
        const mask = masks[index];
        pass.setPipeline(mask ? this.masked : this.solid);
        if (mask) pass.setBindGroup(1, mask);
        meshes.draw(pass, mesh);
      });
      pass.end();
      this.panes.record(encoder, this.casters, face, view, (own) => own.setBindGroup(0, this.faceGroup, offset));
    }
  }
}

function pipeline(gpu, layouts, vertex, fragment) {
  const module = gpu.module("shadow");
  return gpu.render({
    label: vertex,
    layout: gpu.pipelineLayout(layouts),
    vertex: { module, entryPoint: vertex, buffers: [VERTEX_LAYOUT] },
    // Nothing is culled: both sides block light.
    primitive: { topology: "triangle-list" },
    depthStencil: NEARER_WINS,
    fragment: fragment === null ? undefined : { module, entryPoint: fragment, targets: [] },
  });
}

/** Mask of a material, or null where it has none. */
function maskGroup(gpu, meshes, layout, { alphaCutoff, baseColour, baseColourTexture }) {
  if (alphaCutoff === null || alphaCutoff === undefined) return null;
  const numbers = Float32Array.from([...uvRows(baseColourTexture), baseColour[3], alphaCutoff, 0, 0]);
  return gpu.bind(layout, [gpu.uniform("mask", numbers), ...meshes.texture(baseColourTexture)]);
}
