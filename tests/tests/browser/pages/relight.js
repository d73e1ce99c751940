// Draws the states of a job and tells light, pictures and screens as hex digits of their bytes.

import { hexOf } from "/web/chunk/digest.js";
import { BundleSource } from "/web/fetch.js";
import { Frame, featuresOf } from "/web/frame/frame.js";
import { cameraOf, lightsOf } from "/web/frame/lights.js";
import { parseCamera, parseLights } from "/web/frame/words.js";
import { Panorama } from "/web/relight/panorama.js";
import { BakeStream, loadBake } from "/web/relight/stream.js";

const FORMAT = "rgba8unorm";

function hexOfNumbers(numbers) {
  return hexOf(new Uint8Array(numbers.buffer ?? numbers));
}

/** A device, and the errors that it tells of. */
async function openDevice() {
  const adapter = await navigator.gpu?.requestAdapter();
  if (!adapter) throw new Error("there is no WebGPU here");
  const device = await adapter.requestDevice({ requiredFeatures: featuresOf(adapter) });
  const errors = [];
  device.addEventListener("uncapturederror", ({ error }) => errors.push(error.message));
  return { device, errors };
}

function screenOf(device, size) {
  const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC;
  return device.createTexture({ size, format: FORMAT, usage });
}

let opened = null;

/** The panorama of states that have one. */
function panorama() {
  const read = async () => Panorama.read("sky.hdr", new Uint8Array(await (await fetch("/sky.hdr")).arrayBuffer()));
  return (opened ??= read());
}

async function setState(frame, { lights, emitters, camera, materials, lod, sky }) {
  const { manifest } = frame.bake.scene;
  frame.setLights(lights === null ? lightsOf(manifest) : parseLights(lights).lights);
  frame.setEmitters(manifest.emitters.map(() => emitters));
  frame.setMaterials(materials);
  frame.setCamera(camera === null ? cameraOf(manifest) : parseCamera(camera));
  await frame.setLod(lod);
  await frame.setSky(sky && (await panorama()), sky ? { turnDeg: sky[0], strength: sky[1] } : {});
}

/** Light, pictures and exposure that a frame draws for a state. */
async function drawn(frame, state, screen, { limit, samples }) {
  await setState(frame, state);
  const settled = await frame.settle(limit);
  const view = screen.createView();
  const middle = [0, 0];
  frame.draw(view, middle);
  const exposure = await frame.expose();
  frame.draw(view, middle);
  const screened = async () => hexOfNumbers(await frame.gpu.readLayer(screen, 0, 4));
  const found = {
    indirect: hexOfNumbers(await frame.readIndirect()),
    radiance: hexOfNumbers(await frame.readRadiance()),
    screen: await screened(),
  };
  for (let sample = 0; sample < samples; sample++) frame.draw(view);
  return { ...settled, ...found, exposure, smooth: await screened() };
}

/** Turns and scales the panorama of a state: told is what that makes. */
async function turned(frame, { sky: [turnDeg, strength] }, created) {
  const before = frame.gpu.created;
  await frame.setSky(await panorama(), { turnDeg: turnDeg + 90, strength: 2 * strength });
  await frame.settle();
  created.push(frame.gpu.created - before);
}

/** Draws all states of a job with one frame. */
export async function draw(job) {
  const { device, errors } = await openDevice();
  const [width, height] = job.size;
  const options = { width, height, format: FORMAT, shadows: job.shadows, lights: [] };
  const frame = await Frame.create(device, await loadBake(new BundleSource("/bundle")), options);
  const screen = screenOf(device, job.size);
  // The first levels of detail make buffers.
  await frame.setLod("coarse");
  const states = {};
  const created = [];
  for (const state of job.states) {
    const before = frame.gpu.created;
    states[state.name] = await drawn(frame, state, screen, job);
    // A panorama makes a texture.
    if (state.sky === null) created.push(frame.gpu.created - before);
    else await turned(frame, state, created);
  }
  return { states, created, errors };
}

/** E_ind of a state by the overview alone, then with more clusters in so many steps, then anew with all of them. */
export async function refine(job, steps) {
  const { device, errors } = await openDevice();
  const [width, height] = job.size;
  const options = { width, height, format: FORMAT, shadows: job.shadows, lights: [] };
  const stream = await BakeStream.begin(new BundleSource("/bundle"));
  const frame = await Frame.create(device, await stream.bake(), options);
  await setState(frame, job.states[0]);
  await frame.settle(job.limit);
  const found = [{ clusters: stream.clusters, indirect: hexOfNumbers(await frame.readIndirect()) }];
  const all = stream.chunks.reduce((sum, { bytes }) => sum + bytes, 0);
  while (!stream.isWhole) {
    await stream.refine(Math.ceil(all / steps), { lit: await frame.lit(), viewpoint: frame.viewpoint });
    await frame.setLight((await stream.bake()).light, job.limit);
    found.push({ clusters: stream.clusters, indirect: hexOfNumbers(await frame.readIndirect()) });
  }
  const whole = await Frame.create(device, await loadBake(new BundleSource("/bundle")), options);
  await setState(whole, job.states[0]);
  await whole.settle(job.limit);
  return { found, whole: hexOfNumbers(await whole.readIndirect()), errors };
}

/** A device that says that its bindings hold no more than so many bytes. */
function narrowed(device, bindingMax) {
  const limits = new Proxy(device.limits, {
    get: (own, name) => (name === "maxStorageBufferBindingSize" ? bindingMax : own[name]),
  });
  return new Proxy(device, {
    get(own, name) {
      const value = name === "limits" ? limits : own[name];
      return typeof value === "function" ? value.bind(own) : value;
    },
  });
}

/** Bytes of the longest array of a bake's light that is not split. */
function longestWhole({ receivers, columns, clusters, texels }) {
  const vectors = [receivers.count, columns.lambdaCount, clusters.bLen, columns.leafCount + columns.leafCount / 32];
  const arrays = [columns.slots, columns.areas, columns.patches, clusters.columns, texels.texels, texels.sources];
  return Math.max(...vectors.map((count) => 16 * Math.ceil(count)), ...arrays.map(({ byteLength }) => byteLength));
}

/**
 * E_ind of a state on a device as it is and on one whose bindings hold no more than they must, with the pages of each pass there; and
 * the error of one whose bindings hold less.
 */
export async function narrow(job) {
  const { device, errors } = await openDevice();
  const [width, height] = job.size;
  const options = { width, height, format: FORMAT, shadows: job.shadows, lights: [] };
  const bake = await loadBake(new BundleSource("/bundle"));
  const bindingMax = longestWhole(bake.light);
  const found = [];
  let pages = null;
  for (const own of [device, narrowed(device, bindingMax)]) {
    const frame = await Frame.create(own, bake, options);
    await setState(frame, job.states[1]);
    await frame.settle(job.limit);
    found.push(hexOfNumbers(await frame.readIndirect()));
    const { direct, near, basis, reconstruct } = frame.light;
    pages = [direct, near, basis, reconstruct].map((pass) => pass.pages.length);
  }
  const refusal = await Frame.create(narrowed(device, bindingMax - 4), bake, options).catch(({ message }) => message);
  return { found, pages, bindingMax, refusal, errors };
}

/**
 * A device that refuses buffers and textures whose descriptors `refuses` is true for, and has its buffers in `alive` until they are
 * freed.
 */
function picky(device, told) {
  const made = (own, name) => (descriptor) => {
    const thing = own[name](told.refuses(descriptor) ? { ...descriptor, usage: 0 } : descriptor);
    const free = thing.destroy.bind(thing);
    if (name === "createBuffer") told.alive.add(thing);
    thing.destroy = () => {
      told.alive.delete(thing);
      free();
    };
    return thing;
  };
  return new Proxy(device, {
    get(own, name) {
      if (name === "createBuffer" || name === "createTexture") return made(own, name);
      return typeof own[name] === "function" ? own[name].bind(own) : own[name];
    },
  });
}

/**
 * Light, picture, size and buffers of a state by the overview: at first, after light and a size that the device refuses, and after two
 * calls at once for all light and for the overview's. And the errors of the refusals.
 */
export async function keep(job) {
  const { device, errors } = await openDevice();
  const [width, height] = job.size;
  const options = { width, height, format: FORMAT, shadows: job.shadows, lights: [] };
  const stream = await BakeStream.begin(new BundleSource("/bundle"));
  const told = { refuses: () => false, alive: new Set() };
  const bake = await stream.bake();
  const frame = await Frame.create(picky(device, told), bake, options);
  const view = screenOf(device, job.size).createView();
  const look = async () => {
    frame.draw(view, [0, 0]);
    const radiance = hexOfNumbers(await frame.readRadiance());
    return { radiance, indirect: hexOfNumbers(await frame.readIndirect()), size: frame.size, buffers: told.alive.size };
  };
  await setState(frame, job.states[0]);
  await frame.settle(job.limit);
  const found = [await look()];
  await stream.refine(Infinity);
  const whole = (await stream.bake()).light;
  const message = (error) => error.message;
  told.refuses = () => true;
  const refused = [await frame.setLight(whole, job.limit).catch(message)];
  told.refuses = ({ size }) => size[0] === 2 * width;
  refused.push(await frame.resize(2 * width, height).catch(message));
  found.push(await look());
  await Promise.all([whole, bake.light].map((light) => frame.setLight(light, job.limit)));
  found.push(await look());
  return { found, refused, errors };
}

/** Messages of colours that are refused, and whether light and picture stay as they are. */
export async function refuse(job, refused) {
  const { device, errors } = await openDevice();
  const [width, height] = job.size;
  const options = { width, height, format: FORMAT, shadows: job.shadows, lights: [] };
  const frame = await Frame.create(device, await loadBake(new BundleSource("/bundle")), options);
  await setState(frame, job.states[0]);
  await frame.settle(job.limit);
  const messages = refused.map((colours) => {
    try {
      frame.setMaterials(colours);
      return null;
    } catch ({ message }) {
      return message;
    }
  });
  return { messages, settled: frame.settled, errors };
}
