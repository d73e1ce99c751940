// Exposure and tone mapping, from radiance to the screen; twin of client/src/picture/tone.rs.

import { FRAGMENT } from "./gpu.js";

/** Curves from radiance to the range of a screen, as the shader numbers them. */
export const TONES = { linear: 0, reinhard: 1, filmic: 2 };
// Mean that automatic exposure brings the picture's log-average luminance to: middle grey.
const MIDDLE_GREY = 0.18;
// Luminance below this share of the mean is left out of the log-average: black corners would drown it.
const DARKEST_SHARE = 1e-3;
// One in so many pixels, the brightest, may burn out.
const BRIGHTEST_SHARE = 20;
// Exposed luminance above which the curves are nearly flat.
const WHITE = 1;

/**
 * The factor that brings the log-average luminance of surfaces to middle grey, held back where that would burn out the brightest
 * twentieth; `radiance` has four numbers a pixel, alpha tells surfaces (1) from sky (0).
 */
export function automaticExposure(radiance) {
  let luminances = luminancesOf(radiance, (alpha) => alpha > 0.5);
  if (luminances.every((y) => y <= 0)) {
    luminances = luminancesOf(radiance, () => true);
  }
  const average = logAverage(luminances);
  if (average === null) return 1;
  const middle = MIDDLE_GREY / average;
  const rank = luminances.length - 1 - Math.floor(luminances.length / BRIGHTEST_SHARE);
  const bright = luminances.sort()[rank];
  return bright * middle > WHITE ? Math.sqrt((middle * WHITE) / bright) : middle;
}

function luminancesOf(radiance, isWanted) {
  const found = new Float32Array(radiance.length / 4);
  let count = 0;
  for (let at = 0; at < radiance.length; at += 4) {
    const y = 0.2126 * radiance[at] + 0.7152 * radiance[at + 1] + 0.0722 * radiance[at + 2];
    if (isWanted(radiance[at + 3]) && Number.isFinite(y)) {
      found[count++] = y;
    }
  }
  return found.subarray(0, count);
}

/** Null where nothing is lit. */
function logAverage(luminances) {
  const mean = luminances.reduce((sum, y) => sum + y, 0) / Math.max(luminances.length, 1);
  let [sum, count] = [0, 0];
  for (const y of luminances) {
    if (y > DARKEST_SHARE * mean) {
      sum += Math.log(y);
      count += 1;
    }
  }
  return count > 0 ? Math.exp(sum / count) : null;
}

// Format of the film: devices blend into it, and its 11 bits are more than a screen shows.
const FILM = "rgba16float";
// A sample's share of the film is the constant.
const SHARED = { srcFactor: "constant", dstFactor: "one-minus-constant" };

/** The passes that add radiance to a film and show it in the format of a canvas. */
export class TonePass {
  static async create(gpu, format) {
    const pass = new TonePass();
    pass.gpu = gpu;
    pass.layout = gpu.bindLayout([
      { visibility: FRAGMENT, buffer: { type: "uniform" } },
      { visibility: FRAGMENT, texture: { sampleType: "unfilterable-float" } },
    ]);
    pass.numbers = gpu.uniform("tone", new Float32Array(2));
    const layout = gpu.pipelineLayout([pass.layout]);
    const targets = { tone: { format: FILM, blend: { color: SHARED, alpha: SHARED } }, show: { format } };
    for (const [entryPoint, target] of Object.entries(targets)) {
      const module = gpu.module("tone");
      pass[`${entryPoint}Pipeline`] = await gpu.render({
        label: entryPoint,
        layout,
        vertex: { module, entryPoint: "corner" },
        primitive: { topology: "triangle-list" },
        fragment: { module, entryPoint, targets: [target] },
      });
    }
    return pass;
  }

  /** Binds the radiance to show, and makes a film of its size: width and height in pixels. */
  bind(radiance, size) {
    this.film?.destroy();
    const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.TEXTURE_BINDING;
    this.film = this.gpu.texture({ label: "film", size, format: FILM, usage });
    this.filmView = this.film.createView();
    this.toneGroup = this.gpu.bind(this.layout, [this.numbers, radiance]);
    this.showGroup = this.gpu.bind(this.layout, [this.numbers, this.filmView]);
  }

  /** Records sample number `sample`, from 0, of a picture. */
  add(encoder, { exposure, curve, sample }) {
    this.gpu.write(this.numbers, new Float32Array([exposure, curve]));
    const loadOp = sample === 0 ? "clear" : "load";
    draw(encoder, this.tonePipeline, this.toneGroup, this.filmView, loadOp, 1 / (sample + 1));
  }

  /** Shows the mean of all samples in a view. */
  show(encoder, view) {
    draw(encoder, this.showPipeline, this.showGroup, view, "clear", 1);
  }
}

/** Draws one triangle over a whole view. */
function draw(encoder, pipeline, group, view, loadOp, share) {
  const pass = encoder.beginRenderPass({ colorAttachments: [{ view, loadOp, storeOp: "store" }] });
  pass.setPipeline(pipeline);
  pass.setBindGroup(0, group);
  pass.setBlendConstant([share, share, share, share]);
  pass.draw(3);
  pass.end();
}
