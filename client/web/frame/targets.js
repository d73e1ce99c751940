// Textures that are drawn into, and their depth tests.

/** Depth test of reversed depth. */
export const NEARER_WINS = { format: "depth32float", depthWriteEnabled: true, depthCompare: "greater" };

/** Depth test that leaves the depth as it is. */
export const TESTED_ALONE = { ...NEARER_WINS, depthWriteEnabled: false };

/** A depth attachment that starts infinitely far. */
export function clearedDepth(view) {
  return { view, depthClearValue: 0, depthLoadOp: "clear", depthStoreOp: "store" };
}

/** A map for each of so many faces; of none, one texel that nobody reads. */
export function createMaps(gpu, side, layers, format) {
  const own = layers === 0 ? 1 : side;
  return gpu.texture({
    label: "shadow maps",
    size: [own, own, Math.max(layers, 1)],
    format,
    usage: GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.TEXTURE_BINDING | GPUTextureUsage.COPY_SRC,
  });
}

export function faceView(maps, baseArrayLayer) {
  return maps.createView({ dimension: "2d", baseArrayLayer, arrayLayerCount: 1 });
}

/** All layers of a texture, even when there is one. */
export function arrayView(texture) {
  return texture.createView({ dimension: "2d-array" });
}
