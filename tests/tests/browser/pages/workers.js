// Light that Workers put together, beside that of the page's own thread.

import { digestOf } from "/web/chunk/digest.js";
import { BundleSource } from "/web/fetch.js";
import { flatLight } from "/web/relight/flat.js";
import { BakeStream } from "/web/relight/stream.js";

/** Digests of all arrays of a light by their names, with the plain values between them. */
function named(value) {
  if (ArrayBuffer.isView(value)) {
    const bytes = new Uint8Array(value.buffer, value.byteOffset, value.byteLength);
    return `${value.constructor.name} ${value.length} ${digestOf(bytes)}`;
  }
  if (Array.isArray(value)) return value.map(named);
  if (typeof value !== "object" || value === null) return value;
  return Object.fromEntries(Object.entries(value).map(([name, item]) => [name, named(item)]));
}

/** Light by the overview, by some clusters and by all, with so many Workers; and whether there were any. */
export async function lights(base, workers) {
  const stream = await BakeStream.begin(new BundleSource(base), { workers });
  const isElsewhere = stream.isElsewhere;
  const found = [];
  for (const bytesMax of [0, stream.bytes[1] / 3, Infinity]) {
    if (bytesMax > 0) await stream.refine(bytesMax);
    const { scene, light } = await stream.bake();
    found.push({ clusters: stream.clusters, draws: named(scene.draws), light: named(flatLight(light)) });
  }
  stream.close();
  return { isElsewhere, found };
}

/** Light by all clusters where `dead` of the Workers that decode, `workers`, have failed after the first of them came. */
export async function bereft(base, workers, dead) {
  const Own = window.Worker;
  const made = [];
  window.Worker = class extends Own {
    constructor(...args) {
      super(...args);
      made.push(this);
    }
  };
  const stream = await BakeStream.begin(new BundleSource(base), { workers }).finally(() => (window.Worker = Own));
  await stream.refine(stream.bytes[1] / 3);
  // The first puts light together.
  made.slice(1, 1 + dead).forEach((worker) => worker.dispatchEvent(new ErrorEvent("error", { message: "out of memory" })));
  await stream.refine(Infinity);
  const { light } = await stream.bake();
  stream.close();
  return { made: made.length, light: named(flatLight(light)) };
}

/** Kind and code of the error of a bake that cannot be read, and that of a stream that was closed. */
export async function failures(damaged, good) {
  const stream = await BakeStream.begin(new BundleSource(damaged)).catch((error) => error);
  const told = stream instanceof Error ? stream : await stream.refine(Infinity).catch((error) => error);
  const closed = await BakeStream.begin(new BundleSource(good));
  closed.close();
  const ended = await closed.bake().catch((error) => error);
  return [`${told.constructor.name} ${told.name} ${told.code}`, ended.name];
}
