// Workers that decode chunks and put light together beside the page's own thread, which stays free for the reader's hand. Where Workers
// are refused (an old browser, a policy, modules from another server) the page's thread does the same work.
//
//   const work = await openWork();
//   const cluster = await work.decode("cluster", digest, bytes);    // takes the bytes' memory
//   await work.begin({ … }); await work.add(index, cluster); const light = await work.light(isWhole);
//   work.close();

import { buffersOf, errorOf, lightOf } from "./flat.js";
import { LightWork } from "./light_work.js";
import { SkyWork } from "./sky_work.js";

/** Most Workers that decode; one more puts light together. More → the first light sooner, more memory. */
export const WORKERS_MAX = 4;

/** Opens Workers, `count` of which decode; with none, or where they are refused, the work is done on this thread. */
export async function openWork(count = usualCount()) {
  const wanted = Math.min(count, WORKERS_MAX);
  if (wanted < 1) return new WorkHere();
  const workers = [];
  try {
    for (let made = 0; made <= wanted; made++) workers.push(new Remote());
    await Promise.all(workers.map((worker) => worker.ready));
    return new WorkThere(workers);
  } catch {
    workers.forEach((worker) => worker.close(new Error("Workers are refused")));
    return new WorkHere();
  }
}

/** Opens a Worker for one panorama; where it is refused, the work is done on this thread. It has `call` by name, and `close`. */
export async function openSkyWork() {
  try {
    const worker = new Remote();
    await worker.ready;
    return {
      call: (...args) => worker.call(...args),
      close: () => worker.close(new Error("the panorama was closed")),
    };
  } catch {
    const work = new SkyWork();
    const calls = { readSky: "read", takeSky: "take", skyMeans: "means" };
    return { call: async (name, args) => work[calls[name]](...args), close() {} };
  }
}

/** As many as there are cores for, beside this thread. */
function usualCount() {
  return Math.max(1, (navigator.hardwareConcurrency ?? 2) - 1);
}

/** A Worker as calls that are answered. */
class Remote {
  #worker;
  #calls = new Map();
  #next = 0;
  #failure = null;

  /** Throws where Workers of this address are not to be had; others are refused by `ready`. */
  constructor() {
    this.#worker = new Worker(new URL("worker.js", import.meta.url), { type: "module" });
    this.ready = new Promise((resolve, reject) => {
      this.#worker.addEventListener("message", ({ data }) => (data.isReady ? resolve() : this.#answer(data)));
      const broken = (event) => {
        const error = new Error(`a Worker of this page failed (${event.message ?? "no reason told"}): open the page again`);
        reject(error);
        this.close(error);
      };
      ["error", "messageerror"].forEach((type) => this.#worker.addEventListener(type, broken));
    });
    // Nobody may be waiting for it any more.
    this.ready.catch(() => {});
  }

  /** Whether it has failed or was closed: calls fail. */
  get isEnded() {
    return this.#failure !== null;
  }

  /** Calls under way. */
  get load() {
    return this.#calls.size;
  }

  /** Calls by name, and hands over `memory`. */
  call(name, args, memory = []) {
    if (this.#failure !== null) return Promise.reject(this.#failure);
    return new Promise((resolve, reject) => {
      const id = this.#next++;
      this.#calls.set(id, { resolve, reject });
      this.#worker.postMessage({ id, name, args }, memory);
    });
  }

  #answer({ id, value, error }) {
    const { resolve, reject } = this.#calls.get(id) ?? {};
    this.#calls.delete(id);
    if (error === undefined) resolve?.(value);
    else reject?.(errorOf(error));
  }

  /** Ends the Worker; calls under way, and later ones, fail with `error`. */
  close(error) {
    this.#failure ??= error;
    this.#worker.terminate();
    this.#calls.forEach(({ reject }) => reject(this.#failure));
    this.#calls.clear();
  }
}

/** Work in Workers: the first puts light together, the others decode. */
class WorkThere {
  #light;
  #decoders;
  #closed = null;
  // Decodes where no Worker that does is left.
  #here = new WorkHere();

  constructor([light, ...decoders]) {
    [this.#light, this.#decoders] = [light, decoders];
  }

  /** Whether another thread does the work. */
  get isElsewhere() {
    return true;
  }

  decode(kind, digest, bytes) {
    if (this.#closed !== null) return Promise.reject(this.#closed);
    // One that has failed is idle for good.
    const alive = this.#decoders.filter((worker) => !worker.isEnded);
    if (alive.length === 0) return this.#here.decode(kind, digest, bytes);
    const idlest = alive.reduce((best, worker) => (worker.load < best.load ? worker : best));
    return idlest.call("decode", [kind, digest, bytes], [bytes.buffer]);
  }

  begin(parts) {
    const { geometry, patches, overview } = parts;
    return this.#light.call("begin", [parts], buffersOf([geometry, patches, overview]));
  }

  add(index, cluster) {
    return this.#light.call("add", [index, cluster], buffersOf(cluster));
  }

  end(numbers, overview) {
    return this.#light.call("end", [numbers, overview], buffersOf(overview));
  }

  async light(isWhole) {
    return lightOf(await this.#light.call("light", [isWhole]));
  }

  byNeed(...args) {
    return this.#light.call("byNeed", args);
  }

  /** Ends the Workers and frees their memory. */
  close() {
    this.#closed = new DOMException("the bake was closed", "AbortError");
    [this.#light, ...this.#decoders].forEach((worker) => worker.close(this.#closed));
  }
}

/** The same work on this thread. */
class WorkHere {
  #work = new LightWork();

  get isElsewhere() {
    return false;
  }

  async decode(...args) {
    return this.#work.decode(...args);
  }

  async begin(parts) {
    return this.#work.begin(parts);
  }

  async add(...args) {
    this.#work.add(...args);
  }

  async end(...args) {
    this.#work.end(...args);
  }

  async light(isWhole) {
    return this.#work.light(isWhole);
  }

  async byNeed(...args) {
    return this.#work.byNeed(...args);
  }

  close() {}
}
