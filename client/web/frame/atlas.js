// Irradiance of receivers spread into the lightmap's pages, chart edges extended into empty texels; twin of
// client/src/passes/atlas.

import { THREADS, dispatch, groupsFor } from "./gpu.js";
import { arrayView } from "./targets.js";

export class AtlasPass {
  /** Uploads the texels that hold irradiance; makes the pages: rgb irradiance, alpha the kind of texel. */
  static async create(gpu, { pages }, texels, resident) {
    const pass = new AtlasPass();
    const pipeline = await gpu.compute("atlas", "spread");
    const counts = groupsFor(texels.count);
    const longest = (axis) => pages.reduce((most, page) => Math.max(most, page[axis]), 1);
    const [width, height] = [longest(0), longest(1)];
    const most = gpu.device.limits.maxTextureDimension2D;
    if (Math.max(width, height) > most) {
      throw new Error(`a lightmap page is ${width} × ${height}, this device takes ${most}`);
    }
    const texture = gpu.texture({
      label: "atlas",
      size: [width, height, Math.max(pages.length, 1)],
      format: "rgba32float",
      usage: GPUTextureUsage.STORAGE_BINDING | GPUTextureUsage.TEXTURE_BINDING,
    });
    pass.view = arrayView(texture);
    const group = gpu.bind(pipeline.getBindGroupLayout(0), [
      gpu.uniform("atlas", Uint32Array.from([texels.count, counts[0] * THREADS])),
      gpu.storage("atlas texels", texels.texels),
      gpu.storage("atlas sources", texels.sources),
      resident.eEmit,
      resident.eInd,
      pass.view,
    ]);
    pass.step = { pipeline, groups: [group], counts };
    return pass;
  }

  record(pass) {
    dispatch(pass, this.step);
  }
}
