// Textures of a scene on the device: image files, decoded by the browser, with mip levels averaged in linear light.

// Format whose reads are linear.
const FORMAT = "rgba8unorm-srgb";

/** A white texel, for what has no texture. */
export function whiteTexel(gpu) {
  const white = texture(gpu, 1, 1, 1);
  gpu.device.queue.writeTexture({ texture: white }, new Uint8Array([255, 255, 255, 255]), {}, [1, 1]);
  return white.createView();
}

/**
 * Uploads image files, `{mediaType, bytes}`, with all mip levels. Messages call one by its `name`, else by its number; of one with
 * `channel` "red" that channel alone is read, as alpha.
 */
export async function uploadTextures(gpu, files) {
  if (files.length === 0) return [];
  const pipeline = await gpu.render({
    label: "halve",
    layout: "auto",
    vertex: { module: gpu.module("halve"), entryPoint: "corner" },
    fragment: { module: gpu.module("halve"), entryPoint: "halve", targets: [{ format: FORMAT }] },
    primitive: { topology: "triangle-list" },
  });
  const views = [];
  for (const [index, { mediaType, bytes, name = `texture ${index}`, channel = "colour" }] of files.entries()) {
    const picture = await decoded(mediaType, bytes, name);
    views.push(upload(gpu, pipeline, channel === "red" ? await redAsAlpha(picture) : picture));
  }
  return views;
}

/** A picture with its red channel for alpha, all else white; textures' alpha is linear, as that channel is. */
async function redAsAlpha(picture) {
  const { width, height } = picture;
  const context = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  context.drawImage(picture, 0, 0);
  picture.close();
  const pixels = context.getImageData(0, 0, width, height);
  for (let at = 0; at < pixels.data.length; at += 4) pixels.data.set([255, 255, 255, pixels.data[at]], at);
  return createImageBitmap(pixels, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
}

async function decoded(mediaType, bytes, name) {
  const blob = new Blob([bytes], { type: mediaType });
  try {
    // The very numbers of the file: alpha beside colour, no other colour space.
    return await createImageBitmap(blob, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
  } catch (error) {
    throw new Error(`${name} is no picture that this browser decodes (${error.message})`);
  }
}

function upload(gpu, pipeline, picture) {
  const { width, height } = picture;
  const longest = gpu.device.limits.maxTextureDimension2D;
  if (Math.max(width, height) > longest) {
    throw new Error(`a texture is ${width} × ${height}, this device takes ${longest}`);
  }
  const levels = 1 + Math.floor(Math.log2(Math.max(width, height)));
  const uploaded = texture(gpu, width, height, levels);
  gpu.device.queue.copyExternalImageToTexture({ source: picture }, { texture: uploaded }, [width, height]);
  picture.close();
  const level = (baseMipLevel) => uploaded.createView({ baseMipLevel, mipLevelCount: 1 });
  gpu.submit((encoder) => {
    for (let coarser = 1; coarser < levels; coarser++) {
      const pass = encoder.beginRenderPass({
        colorAttachments: [{ view: level(coarser), loadOp: "clear", storeOp: "store" }],
      });
      pass.setPipeline(pipeline);
      pass.setBindGroup(0, gpu.bind(pipeline.getBindGroupLayout(0), [level(coarser - 1)]));
      pass.draw(3);
      pass.end();
    }
  });
  return uploaded.createView();
}

function texture(gpu, width, height, mipLevelCount) {
  const usage = GPUTextureUsage.TEXTURE_BINDING | GPUTextureUsage.COPY_DST | GPUTextureUsage.RENDER_ATTACHMENT;
  return gpu.texture({ label: "texture", size: [width, height], mipLevelCount, format: FORMAT, usage });
}
