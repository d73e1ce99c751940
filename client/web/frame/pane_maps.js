// Glass in shadow maps on the device: depth of the nearest, and the share of light that passes; twin of
// client/src/passes/shadow/panes.rs.

import { FRAGMENT, VERTEX } from "./gpu.js";
import { SAMPLED, VERTEX_LAYOUT, uvRows } from "./meshes.js";
import { NEARER_WINS, TESTED_ALONE, clearedDepth, createMaps, faceView } from "./targets.js";

// Format of the shares: devices multiply into it.
const PASSED = "r16float";
const MULTIPLIED = { srcFactor: "dst", dstFactor: "zero", operation: "add" };

/** Whether some mesh of a scene is of glass. */
function hasGlass({ draws, manifest }) {
  return draws.some(({ material }) => manifest.materials[material].glass);
}

export class PaneMaps {
  /** Makes room for maps in a scene with glass, in others for one texel that nobody reads. */
  static async create(gpu, scene, meshes, room, faceLayout) {
    const maps = new PaneMaps();
    maps.meshes = meshes;
    const layers = hasGlass(scene) ? room.faces : 0;
    maps.isUsed = layers > 0;
    maps.depthMaps = createMaps(gpu, room.side, layers, NEARER_WINS.format);
    maps.passedMaps = createMaps(gpu, room.side, layers, PASSED);
    const views = (texture) => Array.from({ length: layers }, (_, layer) => faceView(texture, layer));
    [maps.depthViews, maps.passedViews] = [views(maps.depthMaps), views(maps.passedMaps)];
    const layout = gpu.bindLayout([{ visibility: VERTEX | FRAGMENT, buffer: { type: "uniform" } }, ...SAMPLED, ...SAMPLED]);
    maps.panes = meshes.meshes.map(({ material }) => {
      return paneGroup(gpu, meshes, layout, scene.manifest.materials[material]);
    });
    const pipelineLayout = gpu.pipelineLayout([faceLayout, layout]);
    maps.depth = await pipeline(gpu, pipelineLayout, "depth", [], NEARER_WINS);
    const target = { format: PASSED, blend: { color: MULTIPLIED, alpha: MULTIPLIED } };
    maps.passed = await pipeline(gpu, pipelineLayout, "passed", [target], TESTED_ALONE);
    return maps;
  }

  isGlass(mesh) {
    return this.panes[mesh] !== null;
  }

  /** Records both passes of a face, whose opaque surfaces are drawn. */
  record(encoder, face, opaque, bindFace) {
    if (!this.isUsed) return;
    const depth = encoder.beginRenderPass({
      label: "depth of glass",
      colorAttachments: [],
      depthStencilAttachment: clearedDepth(this.depthViews[face]),
    });
    depth.setPipeline(this.depth);
    bindFace(depth);
    this.#draw(depth);
    depth.end();
    const passed = encoder.beginRenderPass({
      label: "light through glass",
      colorAttachments: [
        { view: this.passedViews[face], clearValue: [1, 1, 1, 1], loadOp: "clear", storeOp: "store" },
      ],
      depthStencilAttachment: { view: opaque, depthLoadOp: "load", depthStoreOp: "store" },
    });
    passed.setPipeline(this.passed);
    bindFace(passed);
    this.#draw(passed);
    passed.end();
  }

  #draw(pass) {
    this.meshes.meshes.forEach((mesh, index) => {
      if (this.panes[index] !== null) {
        pass.setBindGroup(1, this.panes[index]);
        this.meshes.draw(pass, mesh);
      }
    });
  }
}

/** Glass of a material, or null where it is none. */
function paneGroup(gpu, meshes, layout, { glass, baseColour, baseColourTexture, alphaCutoff }) {
  if (!glass) return null;
  const rows = [...uvRows(baseColourTexture), ...uvRows(glass.transmissionTexture)];
  const numbers = [...rows, ...baseColour, glass.transmission, glass.blends ? 1 : 0, alphaCutoff ?? -1, 0];
  const textures = [...meshes.texture(baseColourTexture), ...meshes.texture(glass.transmissionTexture)];
  return gpu.bind(layout, [gpu.uniform("pane", Float32Array.from(numbers)), ...textures]);
}

function pipeline(gpu, layout, fragment, targets, depthStencil) {
  const module = gpu.module("shadow-panes");
  return gpu.render({
    label: fragment,
    layout,
    vertex: { module, entryPoint: "corner", buffers: [VERTEX_LAYOUT] },
    // Nothing is culled: both sides stop as much light.
    primitive: { topology: "triangle-list" },
    depthStencil,
    fragment: { module, entryPoint: fragment, targets },
  });
}
