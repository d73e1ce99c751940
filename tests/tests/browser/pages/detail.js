// Levels of detail: words, plans of eyes, and light that comes while they are set.

import { hexOf } from "/web/chunk/digest.js";
import { BundleSource } from "/web/fetch.js";
import { Frame } from "/web/frame/frame.js";
import { lodFromText } from "/web/frame/lod_words.js";
import { LodPlan } from "/web/relight/lod_plan.js";
import { BakeStream, loadBake } from "/web/relight/stream.js";

const LIMIT = { bouncesMax: 200, changeMax: 1e-5 };

function hexOfNumbers(numbers) {
  return hexOf(new Uint8Array(numbers.buffer, numbers.byteOffset, numbers.byteLength));
}

/** Errors of words; null for those that are none. */
export async function refusals(texts) {
  return texts.map((text) => {
    try {
      lodFromText(text);
      return null;
    } catch ({ message }) {
      return message;
    }
  });
}

/** The table of a bake's levels of detail, and for each of some settings the plans of eyes, one after the other. */
export async function plans(settings, eyes) {
  const { light } = await loadBake(new BundleSource("/bundle"));
  const planned = settings.map((words) => {
    const lod = lodFromText(words);
    let before = null;
    return eyes.map(({ positionM, forward, viewCos, diagonalM }) => {
      const eye = {
        positionM: positionM.map(Math.fround),
        forward: forward.map(Math.fround),
        viewCos: Math.fround(viewCos),
        diagonalM: Math.fround(diagonalM),
      };
      before = new LodPlan(light.lod, light.clusters, lod, eye, before);
      const { levels, details, view, cycle } = before;
      return { levels: [...levels], details: hexOfNumbers(details), view: hexOfNumbers(view), cycle, counts: before.counts(light.clusters) };
    });
  });
  return { order: hexOfNumbers(light.lod.order), standIns: light.lod.standIns.map(hexOfNumbers), planned };
}

/** A frame of a bake, its device, and that device's errors. */
async function framed(bake) {
  const device = await (await navigator.gpu.requestAdapter()).requestDevice();
  const errors = [];
  device.addEventListener("uncapturederror", ({ error }) => errors.push(error.message));
  const frame = await Frame.create(device, bake, { width: 160, height: 120, format: "rgba8unorm" });
  return { frame, errors };
}

/**
 * Levels that are set while the overview alone is there stay when all light has come: receivers by the work's counts, and the largest
 * difference from light that came at once, over the largest light; with and without the levels. A refusal changes nothing.
 */
export async function growing(words) {
  const stream = await BakeStream.begin(new BundleSource("/bundle"));
  const { frame, errors } = await framed(await stream.bake());
  const receivers = () => frame.lodCounts?.reduce((sum, count) => sum + count.receivers, 0) ?? null;
  const found = [receivers()];
  const early = frame.setLod(words);
  const refusal = await frame.setLod("rough").catch(({ message }) => message);
  await early;
  found.push(receivers());
  await stream.refine(Infinity);
  await frame.setLight((await stream.bake()).light, LIMIT);
  found.push(receivers());
  const whole = (await framed(await loadBake(new BundleSource("/bundle")))).frame;
  await whole.setLod(words);
  await whole.settle(LIMIT);
  const before = frame.gpu.created;
  const differences = [await difference(frame, whole)];
  for (const one of [frame, whole]) await one.setLod(null);
  differences.push(await difference(frame, whole));
  await frame.settle(LIMIT);
  await whole.settle(LIMIT);
  differences.push(await difference(frame, whole));
  // A frame whose eye is at the other end of the scene.
  await frame.setLod(words);
  frame.setCamera({ ...frame.camera, eyeM: frame.boundsM[1], targetM: frame.boundsM[0] });
  await frame.settle(LIMIT);
  differences.push(await difference(frame, whole));
  return { found, all: whole.bake.light.receivers.count, refusal, differences, made: frame.gpu.created - before, errors };
}

async function difference(frame, other) {
  const [a, b] = [await frame.readIndirect(), await other.readIndirect()];
  const largest = b.reduce((most, value) => Math.max(most, Math.abs(value)), 0);
  return a.length === b.length ? a.reduce((most, value, at) => Math.max(most, Math.abs(value - b[at])), 0) / largest : null;
}
