// Objects: files read at times of their animations, frames that draw them, and files that are refused.

import { hexOf } from "/web/chunk/digest.js";
import { BundleSource } from "/web/fetch.js";
import { Frame, featuresOf } from "/web/frame/frame.js";
import { parseCamera, parseLights } from "/web/frame/words.js";
import { decompressed } from "/web/object/meshopt.js";
import { SceneObject } from "/web/object/object.js";
import { loadBake } from "/web/relight/stream.js";

const FORMAT = "rgba8unorm";

function bytesOf(hex) {
  return Uint8Array.from({ length: hex.length / 2 }, (_, at) => parseInt(hex.slice(2 * at, 2 * at + 2), 16));
}

function hexOfNumbers(numbers) {
  return hexOf(new Uint8Array(numbers.buffer ?? numbers));
}

/** Numbers of a draw's triangles, corner by corner: place, normal, texture coordinates, colour. */
function cornersOf({ positionM, normal, uv, colour, triangles }) {
  const numbers = [];
  for (const vertex of triangles) {
    numbers.push(...positionM.subarray(3 * vertex, 3 * vertex + 3), ...normal.subarray(3 * vertex, 3 * vertex + 3));
    numbers.push(...(uv.length > 0 ? uv.subarray(2 * vertex, 2 * vertex + 2) : [0, 0]));
    numbers.push(...(colour.length > 0 ? colour.subarray(4 * vertex, 4 * vertex + 4) : [1, 1, 1, 1]));
  }
  return hexOfNumbers(Float32Array.from(numbers));
}

/** Lengths, warnings, materials, and draws at times of animations; or the words with which a file is refused. */
function readOne(file, times) {
  try {
    const object = SceneObject.fromGlb("toy", file);
    const drawsAt = ([clip, timeS]) => {
      return object.draws(clip, timeS).map((draw) => ({ material: draw.material, corners: cornersOf(draw) }));
    };
    const { materials, lengthsS, warnings, textures } = object;
    return { lengthsS, warnings, materials, textures: textures.length, draws: times.map(drawsAt) };
  } catch (error) {
    return error.name === "ObjectError" ? { error: error.message } : { thrown: String(error.stack) };
  }
}

/** What is read of files, each at times. */
export async function read(files, times) {
  return files.map((hex) => readOne(bytesOf(hex), times));
}

/** What is read of many files one after the other, each with its length before it, and the longest time that one took. */
export async function readAll(url, times) {
  const bytes = new Uint8Array(await (await fetch(url)).arrayBuffer());
  const [told, view] = [[], new DataView(bytes.buffer)];
  let longestMs = 0;
  for (let at = 0; at < bytes.length; ) {
    const length = view.getUint32(at, true);
    const start = performance.now();
    told.push(readOne(bytes.subarray(at + 4, at + 4 + length), times));
    longestMs = Math.max(longestMs, performance.now() - start);
    at += 4 + length;
  }
  return { told, longestMs };
}

/** Bytes of compressed views; null for those that cannot be read. */
export async function decompress(streams) {
  return streams.map(({ bytes, ...stream }) => {
    const found = decompressed(bytesOf(bytes), stream);
    return found && hexOf(found);
  });
}

async function openDevice() {
  const adapter = await navigator.gpu?.requestAdapter();
  if (!adapter) throw new Error("there is no WebGPU here");
  const device = await adapter.requestDevice({ requiredFeatures: featuresOf(adapter) });
  const errors = [];
  device.addEventListener("uncapturederror", ({ error }) => errors.push(error.message));
  return { device, errors };
}

async function frameOf(device, { size: [width, height], shadows, camera }) {
  const options = { width, height, format: FORMAT, shadows, lights: [], camera: parseCamera(camera) };
  return Frame.create(device, await loadBake(new BundleSource("/bundle")), options);
}

async function drawn(frame, screen, limit) {
  const settled = await frame.settle(limit);
  frame.draw(screen.createView(), [0, 0]);
  const [indirect, radiance] = [await frame.readIndirect(), await frame.readRadiance()];
  return { ...settled, indirect: hexOfNumbers(indirect), radiance: hexOfNumbers(radiance) };
}

function screenOf(device, size) {
  const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC;
  return device.createTexture({ size, format: FORMAT, usage });
}

function toysOf({ files }) {
  return files.map((hex, at) => SceneObject.fromGlb(`toy ${at}`, bytesOf(hex)));
}

/**
 * Light and pictures of a bake with objects in each state of a job, `{lights, stances}`, with one frame; what moving makes; and the same
 * without objects, before they come and after they have gone.
 */
export async function draw(job) {
  const { device, errors } = await openDevice();
  const frame = await frameOf(device, job);
  const screen = screenOf(device, job.size);
  frame.setEmitters(frame.bake.scene.manifest.emitters.map(() => job.emitters));
  frame.setLights(parseLights(job.states[0].lights).lights);
  const without = [await drawn(frame, screen, job.limit)];
  await frame.setObjects(toysOf(job));
  const [found, created] = [[], []];
  for (const { lights, stances } of job.states) {
    const before = frame.gpu.created;
    frame.setLights(parseLights(lights).lights);
    frame.moveObjects(stances);
    found.push(await drawn(frame, screen, job.limit));
    created.push(frame.gpu.created - before);
  }
  await frame.setObjects([]);
  frame.setLights(parseLights(job.states[0].lights).lights);
  without.push(await drawn(frame, screen, job.limit));
  return { found, created, without, errors };
}

/** Bounces that `settle` and `setLight` make while an object plays, one step after each; at most so many: null where they do not end. */
export async function play(job, most) {
  const { device, errors } = await openDevice();
  const frame = await frameOf(device, job);
  frame.setLights(parseLights(job.states[0].lights).lights);
  const [stance] = job.states[0].stances;
  await frame.setObjects(toysOf(job), [stance]);
  const advance = frame.advance.bind(frame);
  const made = async (call) => {
    let bounces = 0;
    const tooMany = new Promise((resolve) => {
      frame.advance = () => {
        if (++bounces > most) resolve(null);
        frame.moveObject(0, { ...stance, timeS: 0.01 * (bounces % 50) });
        return advance();
      };
    });
    const ended = await Promise.race([call().then(() => bounces), tooMany]);
    if (ended === null) device.destroy();
    return ended;
  };
  const settle = await made(() => frame.settle({ bouncesMax: 20 }));
  const setLight = settle && (await made(() => frame.setLight(frame.bake.light, { bouncesMax: 20 })));
  return { settle, setLight, errors };
}

/** The words with which a frame refuses objects and stances, and whether the picture stays. */
export async function refuse(job, wrongFile) {
  const { device, errors } = await openDevice();
  const frame = await frameOf(device, job);
  const screen = screenOf(device, job.size);
  frame.setLights(parseLights(job.states[0].lights).lights);
  const [toy] = toysOf(job);
  const stances = job.states[0].stances.slice(0, 1);
  await frame.setObjects([toy], stances);
  const before = await drawn(frame, screen, job.limit);
  const told = async (call) => {
    try {
      await call();
      return null;
    } catch ({ message }) {
      return message;
    }
  };
  const mesh = { positionM: [0, 0, 0, 1, 0, 0, 0, 1, 0], normal: [0, 0, 1, 0, 0, 1, 0, 0, 1], triangles: [0, 1, 2] };
  const of = (more, rest = {}) => SceneObject.fromMeshes("own", { draws: [{ ...mesh, ...more }], ...rest });
  const add = (object) => () => frame.setObjects([toy, object]);
  const messages = [
    await told(() => frame.moveObjects([{}, {}])),
    await told(() => frame.moveObject(0, { scale: 0 })),
    await told(() => frame.moveObject(0, { positionM: [NaN, 0, 0] })),
    await told(() => frame.moveObject(1, {})),
    await told(() => frame.moveObject(0, { clip: 7 })),
    await told(() => frame.moveObject(0, { positionM: [3e38, 3e38, 3e38], scale: 3e38 })),
    await told(add(of({ triangles: [0, 1, 3] }))),
    await told(add(of({ material: 1 }))),
    await told(add(of({ normal: [0, 0, 1] }))),
    await told(add(of({ positionM: [0, 0, 0, 1, 0, 0, 0, Infinity, 0] }))),
    await told(add(of({}, { materials: [{ baseColourTexture: { texture: 0, wrap: ["clamp", "clamp"], transform: null } }] }))),
    await told(add(SceneObject.fromMeshes("none", { draws: [] }))),
    await told(add(SceneObject.fromGlb("wrong", bytesOf(wrongFile)))),
    await told(() => frame.setObjects(new Array(257).fill(toy))),
  ];
  // The toy alone stands where it stood, also once it has been away.
  frame.moveObjects([{}]);
  frame.moveObjects(stances);
  const after = await drawn(frame, screen, job.limit);
  const kept = { objects: frame.objects.objects.length, radiance: [before.radiance, after.radiance] };
  await frame.setObjects([toy, of({})]);
  return { messages, kept, stances: frame.objects.stances, errors };
}
