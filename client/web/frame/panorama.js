// A panorama behind the scene on the device; twin of client/src/passes/shade/panorama.rs.

import { fround } from "../relight/numbers.js";
import { FRAGMENT, VERTEX } from "./gpu.js";

const KINDS = [
  { visibility: VERTEX | FRAGMENT, buffer: { type: "uniform" } },
  { visibility: FRAGMENT, buffer: { type: "uniform" } },
  { visibility: FRAGMENT, texture: { sampleType: "unfilterable-float" } },
];

export class PanoramaPass {
  /** Uploads a panorama for pictures of a format; `view` is the buffer of the view. Frees all of it where that fails. */
  static async create(whole, panorama, view, { format, depthStencil }) {
    const pass = new PanoramaPass();
    [pass.gpu, pass.panorama] = [whole.branch(), panorama];
    try {
      const { gpu } = pass;
      const layout = gpu.bindLayout(KINDS);
      const module = gpu.module("panorama");
      pass.pipeline = await gpu.render({
        label: "panorama",
        layout: gpu.pipelineLayout([layout]),
        vertex: { module, entryPoint: "sky_corner" },
        primitive: { topology: "triangle-list" },
        depthStencil,
        fragment: { module, entryPoint: "panorama_sky", targets: [{ format }] },
      });
      pass.numbers = gpu.buffer("panorama", 16, GPUBufferUsage.UNIFORM);
      pass.group = gpu.bind(layout, [view, pass.numbers, uploaded(gpu, panorama).createView()]);
    } catch (error) {
      pass.destroy();
      throw error;
    }
    return pass;
  }

  /** Frees the texture. */
  destroy() {
    this.gpu.destroy();
  }

  /** Turns and scales it. */
  set(turnDeg, strength) {
    const turn = (turnDeg * Math.PI) / 180;
    const numbers = [Math.cos(turn), Math.sin(turn), fround(strength) * this.panorama.scale, 0];
    this.gpu.write(this.numbers, Float32Array.from(numbers));
  }

  /** Records it, before all else. */
  record(pass) {
    pass.setPipeline(this.pipeline);
    pass.setBindGroup(0, this.group);
    pass.draw(3);
  }
}

function uploaded(gpu, { width, height, texels }) {
  const most = gpu.device.limits.maxTextureDimension2D;
  if (Math.max(width, height) > most) {
    throw new Error(`a panorama of ${width} × ${height} pixels is wider than the ${most} of this device`);
  }
  const usage = GPUTextureUsage.TEXTURE_BINDING | GPUTextureUsage.COPY_DST;
  const texture = gpu.texture({ label: "panorama", size: [width, height], format: "rgba16float", usage });
  gpu.device.queue.writeTexture({ texture }, texels, { bytesPerRow: 8 * width }, [width, height]);
  return texture;
}
