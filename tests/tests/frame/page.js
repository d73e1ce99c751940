// Draws the states of a job and sends back light, pictures and screens as plain numbers.

import { decodeCluster } from "../chunk/cluster.js";
import { decodeGeometry } from "../chunk/geometry.js";
import { chunksOf, readManifest, withDirectory } from "../chunk/manifest.js";
import { decodePatches } from "../chunk/patches.js";
import { decodeTexture } from "../chunk/texture.js";
import { Frame, featuresOf } from "../frame/frame.js";
import { cameraOf, lightsOf } from "../frame/lights.js";
import { parseCamera, parseLights } from "../frame/words.js";
import { assembleBake } from "../relight/bake.js";

// End of the bounces: that of the references.
const LIMIT = { bouncesMax: 64, changeMax: 1e-5 };
const FORMAT = "rgba8unorm";

async function bytesOf(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error(`${path}: ${response.status}`);
  return new Uint8Array(await response.arrayBuffer());
}

async function loadBake() {
  const read = readManifest(await bytesOf("/bundle/manifest.json"));
  const all = (role) => Promise.all(chunksOf(read, role).map(({ digest }) => bytesOf(`/bundle/chunks/${digest}`)));
  const manifest = withDirectory(read, await all("directory"));
  const decoded = async (role, decode) => {
    const bytes = chunksOf(manifest, role).map(({ digest }) => bytesOf(`/bundle/chunks/${digest}`));
    return (await Promise.all(bytes)).map((chunk) => decode(chunk));
  };
  return assembleBake({
    manifest,
    geometry: await decoded("geometry", decodeGeometry),
    textures: await decoded("textures", decodeTexture),
    clusters: await decoded("clusters", decodeCluster),
    patches: await decoded("patches", decodePatches),
  });
}

function send(name, body) {
  return fetch(`/answer/${name}`, { method: "POST", body });
}

// Draws a state and answers what it took.
async function drawState(frame, { name, lights, emitters, camera }, screen) {
  const { manifest } = frame.bake.scene;
  frame.setLights(lights === null ? lightsOf(manifest) : parseLights(lights).lights);
  frame.setEmitters(manifest.emitters.map(() => emitters));
  frame.setCamera(camera === null ? cameraOf(manifest) : parseCamera(camera));
  const settled = await frame.settle(LIMIT);
  frame.draw(screen.createView());
  const exposure = await frame.expose();
  frame.draw(screen.createView());
  await send(`${name}/indirect`, await frame.readIndirect());
  await send(`${name}/radiance`, await frame.readRadiance());
  await send(`${name}/screen`, await frame.gpu.readLayer(screen, 0, 4));
  return { ...settled, exposure };
}

async function main() {
  const job = await (await fetch("/job.json")).json();
  const adapter = await navigator.gpu?.requestAdapter();
  if (!adapter) throw new Error("there is no WebGPU here");
  const device = await adapter.requestDevice({ requiredFeatures: featuresOf(adapter) });
  const errors = [];
  device.addEventListener("uncapturederror", ({ error }) => errors.push(error.message));
  const [width, height] = job.size;
  const options = { width, height, format: FORMAT, shadows: job.shadows, lights: [] };
  const frame = await Frame.create(device, await loadBake(), options);
  const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC;
  const screen = device.createTexture({ size: job.size, format: FORMAT, usage });
  const before = frame.gpu.created;
  const states = {};
  for (const state of job.states) {
    states[state.name] = await drawState(frame, state, screen);
  }
  return { states, created: [before, frame.gpu.created], errors };
}

main()
  .then((done) => send("done", JSON.stringify(done)))
  .catch((error) => send("failed", String(error.stack ?? error)));
