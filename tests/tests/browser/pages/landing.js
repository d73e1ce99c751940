// A bake that goes on: its clusters as they land, and its picture.

import { digestOf } from "/web/chunk/digest.js";
import { BundleSource, ServerSource } from "/web/fetch.js";
import { flatLight } from "/web/relight/flat.js";
import { Following } from "/web/relight/following.js";
import { BakeStream, loadBake } from "/web/relight/stream.js";
import { Viewer } from "/web/view.js";

const source = () => new ServerSource({ bake: "bake" });
const land = (cells, state = "running") => fetch(`/land/${cells}/${state}`);

async function followed() {
  const following = new Following(source());
  if ((await following.hear()) !== "more") throw new Error("no outline has come");
  return following;
}

/** A digest of all arrays of a light, with the plain values between them. */
function digestOfLight(light) {
  const plain = (_, value) => {
    if (typeof value === "bigint") return String(value);
    return ArrayBuffer.isView(value) ? digestOf(new Uint8Array(value.buffer, value.byteOffset, value.byteLength)) : value;
  };
  return digestOf(new TextEncoder().encode(JSON.stringify(flatLight(light), plain)));
}

/** Clusters after each cell of `count` that lands, and the light at the end and of a load at once. */
export async function landed(count, workers) {
  await land(0);
  const stream = await BakeStream.begin(source(), { workers, following: await followed() });
  const steps = [];
  let early = "";
  for (let cells = 0; cells <= count; cells++) {
    await land(cells);
    if (cells > 0 && !(await stream.hear())) throw new Error(`nothing is heard of cell ${cells}`);
    await stream.refine(Infinity);
    early = digestOfLight((await stream.bake()).light);
    steps.push({ cells: stream.cells, clusters: stream.clusters, isWhole: stream.isWhole });
  }
  await land(count, "done");
  await stream.hear();
  const light = digestOfLight((await stream.bake()).light);
  const ended = [stream.isWhole, ...stream.clusters];
  stream.close();
  const whole = digestOfLight((await loadBake(source(), { workers })).light);
  return { steps, early, ended, light, whole };
}

/** Clusters, and those that are lost, while a chunk is not there or damaged, and once its task has run again. */
export async function lost(fault) {
  await land(2);
  await fetch(`/fault/${fault}`);
  const stream = await BakeStream.begin(source(), { workers: 0, following: await followed() });
  // The first, which is the one with the fault, takes no share of the others' bytes.
  await stream.refine(stream.bytes[1] - stream.chunks[0].bytes);
  const without = [stream.lost, ...stream.clusters];
  await fetch("/fault/none");
  await land(3);
  await stream.hear();
  await stream.refine(Infinity);
  const found = { without, after: [stream.lost, ...stream.clusters] };
  stream.close();
  return found;
}

/** The words of a bake that fails. */
export async function failed() {
  await land(0);
  const stream = await BakeStream.begin(source(), { workers: 0, following: await followed() });
  await land(0, "failed");
  return stream.hear().then(() => "none", (error) => error.message);
}

/** The words of a server with a fault in what it tells of a bake. */
export async function refused(fault) {
  await land(0);
  await fetch(`/fault/${fault}`);
  const told = await new Following(source()).hear().then(() => "none", (error) => error.message);
  await fetch("/fault/none");
  return told;
}

/** Clusters of a bundle, and its light, after so many bytes of them; all where it is null. Or the words of its refusal. */
export async function opened(base, bytesMax) {
  try {
    const stream = await BakeStream.begin(new BundleSource(base), { workers: 0 });
    await stream.refine(bytesMax ?? Infinity);
    return { clusters: stream.clusters, isWhole: stream.isWhole, light: digestOfLight((await stream.bake()).light) };
  } catch (error) {
    return { error: String(error.message) };
  }
}

const waitFor = async (isThere) => {
  while (!isThere()) await new Promise((resolve) => setTimeout(resolve, 50));
};

/** Mean radiance without the lamp, once light has settled. */
async function mean(viewer) {
  viewer.lamp.share = 0;
  viewer.changed();
  await waitFor(() => viewer.frame.settled);
  viewer.frame.draw(viewer.context, [0, 0]);
  const radiance = await viewer.frame.readRadiance();
  return radiance.reduce((sum, value, at) => (at % 4 === 3 ? sum : sum + value), 0) / radiance.length;
}

async function viewed(following, words, failures) {
  const canvas = document.createElement("canvas");
  canvas.style.cssText = "width: 160px; height: 120px; display: block";
  document.body.append(canvas);
  const onError = (error) => failures.push(String(error.stack ?? error));
  const onProgress = (told) => words.push(told.words);
  return Viewer.open(canvas, source(), { following, onProgress, onTrouble: onError, onFailure: onError });
}

/** Means of the picture without a cell, after the end of its bake, and of the bake that is done. */
export async function seen(count) {
  const [words, failures] = [[], []];
  await land(0);
  const viewer = await viewed(await followed(), words, failures);
  const early = await mean(viewer);
  await land(count - 1);
  await waitFor(() => words.some((told) => told.includes(`goes on: ${count - 1} of`)) || failures.length > 0);
  await land(count, "done");
  await waitFor(() => words.includes("all light is here") || failures.length > 0);
  const landedMean = await mean(viewer);
  viewer.close();
  const done = [];
  const other = await viewed(null, done, failures);
  await waitFor(() => done.includes("all light is here") || failures.length > 0);
  const whole = await mean(other);
  other.close();
  return { words, failures, early, landed: landedMean, whole };
}
