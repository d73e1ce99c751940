// Glass in shadow maps on the device: depth of the nearest, and the share of light that passes; twin of
// client/src/passes/shadow/panes.rs.

import { FRAGMENT, VERTEX } from "./gpu.js";
import { SAMPLED, VERTEX_LAYOUT, uvRows } from "./meshes.js";
import { NEARER_WINS, TESTED_ALONE, clearedDepth, createMaps, faceView } from "./targets.js";

// Format of the shares: devices multiply into it.
const PASSED = "r16float";
const MULTIPLIED = { srcFactor: "dst", dstFactor: "zero", operation: "add" };

export class PaneMaps {
  /** Makes pipelines, and maps of one texel that nobody reads: scenes of no glass need no others. */
  static async create(gpu, room, faceLayout) {
    const maps = new PaneMaps();
    Object.assign(maps, { gpu, room });
    maps.layout = gpu.bindLayout([{ visibility: VERTEX | FRAGMENT, buffer: { type: "uniform" } }, ...SAMPLED, ...SAMPLED]);
    const pipelineLayout = gpu.pipelineLayout([faceLayout, maps.layout]);
    maps.depth = await pipeline(gpu, pipelineLayout, "depth", [], NEARER_WINS);
    const target = { format: PASSED, blend: { color: MULTIPLIED, alpha: MULTIPLIED } };
    maps.passed = await pipeline(gpu, pipelineLayout, "passed", [target], TESTED_ALONE);
    maps.take(maps.#made(0));
    return maps;
  }

  #made(layers) {
    const { gpu, room } = this;
    const depthMaps = createMaps(gpu, room.side, layers, NEARER_WINS.format);
    const passedMaps = createMaps(gpu, room.side, layers, PASSED);
    const views = (texture) => Array.from({ length: layers }, (_, layer) => faceView(texture, layer));
    return { layers, depthMaps, passedMaps, depthViews: views(depthMaps), passedViews: views(passedMaps) };
  }

  /** Glass of a scene's meshes: a group each, null for what is none. */
  groupsOf(gpu, scene, meshes) {
    return meshes.meshes.map(({ material }) => {
      return paneGroup(gpu, meshes, this.layout, scene.manifest.materials[material]);
    });
  }

  /** Maps with room for all faces, where groups are the first of glass; else null. They are to be taken, or freed. */
  mapsFor(groups) {
    return this.layers === 0 && groups.some((group) => group !== null) ? this.#made(this.room.faces) : null;
  }

  /** Takes other maps, and frees those before. */
  take(made) {
    this.free(this);
    Object.assign(this, made);
  }

  /** Frees maps. */
  free({ depthMaps, passedMaps }) {
    [depthMaps, passedMaps].forEach((maps) => this.gpu.free(maps));
  }

  /** Records both passes of a face, whose opaque surfaces are drawn. */
  record(encoder, { meshes, panes, hasGlass }, face, opaque, bindFace) {
    if (!hasGlass) return;
    const depth = encoder.beginRenderPass({
      label: "depth of glass",
      colorAttachments: [],
      depthStencilAttachment: clearedDepth(this.depthViews[face]),
    });
    depth.setPipeline(this.depth);
    bindFace(depth);
    draw(depth, meshes, panes);
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
    draw(passed, meshes, panes);
    passed.end();
  }
}

function draw(pass, meshes, panes) {
  meshes.meshes.forEach((mesh, index) => {
    if (panes[index] !== null) {
      pass.setBindGroup(1, panes[index]);
      meshes.draw(pass, mesh);
    }
  });
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
