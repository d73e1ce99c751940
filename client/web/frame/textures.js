// Textures of a scene on the device: image files, decoded by the browser, with mip levels averaged in linear light.

// Format whose reads are linear.
const FORMAT = "rgba8unorm-srgb";

/** Uploads image files, `{mediaType, bytes}`, with all mip levels; behind them stands a white texel, for what has no texture. */
export async function uploadTextures(gpu, files) {
  const pipeline = await gpu.render({
    label: "halve",
    layout: "auto",
    vertex: { module: gpu.module("halve"), entryPoint: "corner" },
    fragment: { module: gpu.module("halve"), entryPoint: "halve", targets: [{ format: FORMAT }] },
    primitive: { topology: "triangle-list" },
  });
  const views = [];
  for (const [index, { mediaType, bytes }] of files.entries()) {
    views.push(upload(gpu, pipeline, await decoded(mediaType, bytes, index)));
  }
  const white = texture(gpu, 1, 1, 1);
  gpu.device.queue.writeTexture({ texture: white }, new Uint8Array([255, 255, 255, 255]), {}, [1, 1]);
  return [...views, white.createView()];
}

async function decoded(mediaType, bytes, index) {
  const blob = new Blob([bytes], { type: mediaType });
  try {
    // The very numbers of the file: alpha beside colour, no other colour space.
    return await createImageBitmap(blob, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
  } catch (error) {
    throw new Error(`texture ${index} is no picture that this browser decodes (${error.message})`);
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
