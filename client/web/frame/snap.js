// How far a device moves corners of triangles: most keep eight bits of a pixel, software fewer. Depth in shadow maps lies as much
// aside.

// Pixels of the target, and the step between its rows as a share of a pixel; those of the shader.
const [WIDTH, HEIGHT] = [8, 256];
const STEP = 1 / 4096;
// Texels by which depth may lie aside where corners are moved by so much: depth is taken from several texels.
const SNAP_PER_MOVE = 4;
// That of eight bits: no device is asked for more.
const SNAP_MIN = 1 / 128;

/** Texels by which depth may lie aside on a device; measured by drawing edges ever farther from a pixel's middle. */
export async function measuredSnap(gpu) {
  const format = "r8unorm";
  const module = gpu.module("snap");
  const pipeline = await gpu.render({
    label: "snap",
    layout: "auto",
    vertex: { module, entryPoint: "corner" },
    primitive: { topology: "triangle-strip" },
    fragment: { module, entryPoint: "seen", targets: [{ format }] },
  });
  const own = gpu.branch();
  const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC;
  const target = own.texture({ label: "snap", size: [WIDTH, HEIGHT], format, usage });
  own.submit((encoder) => {
    const view = target.createView();
    const pass = encoder.beginRenderPass({ colorAttachments: [{ view, loadOp: "clear", storeOp: "store" }] });
    pass.setPipeline(pipeline);
    pass.draw(4, HEIGHT);
    pass.end();
  });
  const pixels = new Uint8Array(await own.readLayer(target, 0, 1));
  own.destroy();
  let moved = 0;
  while (moved + 1 < HEIGHT && pixels[(moved + 1) * WIDTH] > 0) moved++;
  return Math.max(SNAP_MIN, SNAP_PER_MOVE * moved * STEP);
}
