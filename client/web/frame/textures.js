// Textures of a scene on the device: image files, decoded by the browser, with mip levels averaged in linear light, or over numbers where
// they hold such.

// Format whose reads are linear.
const FORMAT = "rgba8unorm-srgb";
// Format whose reads are the numbers of a file.
const AS_STORED = "rgba8unorm";
/** Channel of files of linear numbers. */
export const NUMBERS = "numbers";

/** A white texel, for what has no texture. */
export function whiteTexel(gpu) {
  const white = texture(gpu, 1, 1, 1);
  gpu.device.queue.writeTexture({ texture: white }, new Uint8Array([255, 255, 255, 255]), {}, [1, 1]);
  return white.createView();
}

/**
 * Uploads image files, `{mediaType, bytes}`, with all mip levels. Messages call one by its `name`, else by its number; of one with
 * `channel` "red" that channel alone is read, as alpha; one with `NUMBERS` is of linear numbers.
 */
export async function uploadTextures(gpu, files) {
  if (files.length === 0) return [];
  const made = [pipelineOf(gpu, "halve"), pipelineOf(gpu, "red_as_alpha"), pipelineOf(gpu, "halve", AS_STORED)];
  const [halve, redAsAlpha, halveNumbers] = await Promise.all(made);
  const views = [];
  for (const [index, { mediaType, bytes, name = `texture ${index}`, channel = "colour" }] of files.entries()) {
    const picture = await decoded(mediaType, bytes, name);
    const ofNumbers = channel === NUMBERS;
    const [format, coarser] = ofNumbers ? [AS_STORED, halveNumbers] : [FORMAT, halve];
    views.push(upload(gpu, picture, { format, coarser, drawnBy: channel === "red" ? redAsAlpha : null }));
  }
  return views;
}

function pipelineOf(gpu, entryPoint, format = FORMAT) {
  const module = gpu.module("halve");
  return gpu.render({
    label: entryPoint,
    layout: "auto",
    vertex: { module, entryPoint: "corner" },
    fragment: { module, entryPoint, targets: [{ format }] },
    primitive: { topology: "triangle-list" },
  });
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

/** A picture with its mip levels, of which the finest is as it is, or drawn by a pipeline: a canvas loses colours where alpha is 0. */
function upload(gpu, picture, { format, coarser: halve, drawnBy }) {
  const { width, height } = picture;
  const longest = gpu.device.limits.maxTextureDimension2D;
  if (Math.max(width, height) > longest) {
    throw new Error(`a texture is ${width} × ${height}, this device takes ${longest}`);
  }
  const levels = 1 + Math.floor(Math.log2(Math.max(width, height)));
  const uploaded = texture(gpu, width, height, levels, format);
  const level = (baseMipLevel) => uploaded.createView({ baseMipLevel, mipLevelCount: 1 });
  const file = drawnBy === null ? uploaded : texture(gpu, width, height, 1, AS_STORED);
  gpu.device.queue.copyExternalImageToTexture({ source: picture }, { texture: file }, [width, height]);
  picture.close();
  gpu.submit((encoder) => {
    if (drawnBy !== null) drawn(gpu, encoder, drawnBy, file.createView(), level(0));
    for (let coarser = 1; coarser < levels; coarser++) drawn(gpu, encoder, halve, level(coarser - 1), level(coarser));
  });
  if (file !== uploaded) gpu.free(file);
  return uploaded.createView();
}

/** Draws a level from a view of another. */
function drawn(gpu, encoder, pipeline, from, into) {
  const pass = encoder.beginRenderPass({ colorAttachments: [{ view: into, loadOp: "clear", storeOp: "store" }] });
  pass.setPipeline(pipeline);
  pass.setBindGroup(0, gpu.bind(pipeline.getBindGroupLayout(0), [from]));
  pass.draw(3);
  pass.end();
}

function texture(gpu, width, height, mipLevelCount, format = FORMAT) {
  const usage = GPUTextureUsage.TEXTURE_BINDING | GPUTextureUsage.COPY_DST | GPUTextureUsage.RENDER_ATTACHMENT;
  return gpu.texture({ label: "texture", size: [width, height], mipLevelCount, format, usage });
}
