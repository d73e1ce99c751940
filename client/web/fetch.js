// Bakes over HTTP: from a server, or from an unpacked bundle folder that any server of files serves. Bytes are verified by their
// digest, no answer is read beyond the length that it should have, and calls that fail in a way that may pass are made again.
//
//   const source = new ServerSource({ bake: "3f2a…", token });          // or new BundleSource("/bakes/cornell.kiln")
//   const manifest = await fetchManifest(source);                       // with the clusters of its directory
//   const [patches] = await fetchChunks(source, chunksOf(manifest, "patches"), decodePatches);
//   const { cluster, layer } = await fetchCluster(source, manifest, index, { layers: 1 });

import { decodeCluster, decodeClusterPrefix } from "./chunk/cluster.js";
import { verify, verifyPrefix } from "./chunk/digest.js";
import { ROLES, chunksOf, readManifest, withDirectory } from "./chunk/manifest.js";

/** Chunks fetched at a time, if nothing else is asked for. More → faster over long lines, more memory. */
export const PARALLEL = 8;
const MANIFEST_BYTES_MAX = 256 * 2 ** 20;
const JSON_BYTES_MAX = 64 * 2 ** 20;
const PROBLEM_BYTES_MAX = 64 * 2 ** 10;
/** Tries of a call in all, and the longest waits between them: twice as long each time. */
const TRIES = 7;
const WAIT_FIRST_MS = 250;
const WAIT_MAX_MS = 8000;
/** Longest wait that a server may ask for. */
const RETRY_AFTER_MAX_MS = 60_000;
/** Answers that may be others later; those of a server's own problems, and of proxies before it. */
const PASSING = new Set([408, 429, 500, 502, 503, 504, 507]);

/**
 * Why a call failed: `code` is `network`, `status` or `length`; `status` and `problem` (RFC 9457, if the server told one) are those of
 * the answer.
 */
export class FetchError extends Error {
  constructor(code, message, { status = null, problem = null, retryAfterMs = 0, cause } = {}) {
    super(message, cause === undefined ? undefined : { cause });
    this.name = "FetchError";
    this.code = code;
    this.status = status;
    this.problem = problem;
    this.retryAfterMs = retryAfterMs;
  }

  /** Whether the same call may work later. */
  get mayPass() {
    return this.code === "network" || this.code === "length" || (this.code === "status" && PASSING.has(this.status));
  }
}

/** Calls of one server, with a bearer token if it wants one. */
export class Http {
  constructor({ base = "", token = null } = {}) {
    this.base = base.replace(/\/$/, "");
    this.token = token;
  }

  /** Bytes of `path`, at most `bytesMax`; `range` asks for its first bytes alone: `{bytes, isPart}`. */
  async bytes(path, { bytesMax, range = null, signal = null } = {}) {
    return retried(() => this.tryBytes(path, { bytesMax, range, signal }), signal);
  }

  /** The JSON that `path` answers. */
  async json(path, { signal = null, ...init } = {}) {
    return retried(async () => {
      const answer = await this.answer(path, { signal, ...init });
      const bytes = await readBody(answer, JSON_BYTES_MAX, path);
      return bytes.length === 0 ? null : JSON.parse(new TextDecoder().decode(bytes));
    }, signal);
  }

  async tryBytes(path, { bytesMax, range, signal }) {
    const headers = range === null ? {} : { range: `bytes=0-${range - 1}` };
    const answer = await this.answer(path, { headers, signal });
    const isPart = answer.status === 206;
    // A server may ignore the range and send all.
    return { bytes: await readBody(answer, isPart ? range : bytesMax, path), isPart };
  }

  /** An answer of a good status. */
  async answer(path, { headers = {}, ...init }) {
    const authorization = this.token === null ? {} : { authorization: `Bearer ${this.token}` };
    let answer;
    try {
      answer = await fetch(`${this.base}${path}`, { ...init, headers: { ...authorization, ...headers } });
    } catch (cause) {
      if (init.signal?.aborted) throw cause;
      throw new FetchError("network", `${path} cannot be reached`, { cause });
    }
    if (answer.ok) return answer;
    throw await failureOf(answer, path);
  }
}

/** The error of an answer, in the words of its problem if it has one. */
async function failureOf(answer, path) {
  const problem = await problemOf(answer, path);
  const detail = typeof problem?.detail === "string" ? problem.detail : `the server answered ${answer.status}`;
  const seconds = Number(answer.headers.get("retry-after"));
  const retryAfterMs = Number.isFinite(seconds) ? Math.min(1000 * Math.max(seconds, 0), RETRY_AFTER_MAX_MS) : 0;
  return new FetchError("status", `${path}: ${detail}`, { status: answer.status, problem, retryAfterMs });
}

/** The problem of an answer; null where its body is none, or too long for one. */
async function problemOf(answer, path) {
  try {
    return JSON.parse(new TextDecoder().decode(await readBody(answer, PROBLEM_BYTES_MAX, path)));
  } catch {
    return null;
  }
}

/** Reads a body to its end, but no more than `bytesMax`. */
async function readBody(answer, bytesMax, path) {
  const pieces = [];
  let length = 0;
  const reader = answer.body?.getReader();
  for (;;) {
    const { done, value } = (await reader?.read().catch((cause) => broken(path, cause))) ?? { done: true };
    if (done) break;
    length += value.length;
    if (length > bytesMax) {
      await reader.cancel();
      throw new FetchError("length", `${path} has more than the ${bytesMax} bytes that it should have`);
    }
    pieces.push(value);
  }
  const bytes = new Uint8Array(length);
  let at = 0;
  for (const piece of pieces) {
    bytes.set(piece, at);
    at += piece.length;
  }
  return bytes;
}

function broken(path, cause) {
  if (cause?.name === "AbortError") throw cause;
  throw new FetchError("network", `${path} broke off`, { cause });
}

/** Makes `call` until it works, fails for good, or has failed often enough. */
async function retried(call, signal) {
  for (let turn = 1; ; turn++) {
    try {
      return await call();
    } catch (error) {
      if (!(error instanceof FetchError) || !error.mayPass || turn === TRIES) throw error;
      const longest = Math.min(WAIT_FIRST_MS * 2 ** (turn - 1), WAIT_MAX_MS);
      // Half of the wait is by chance, so that readers that were cut off together come back one by one.
      await sleep(error.retryAfterMs + longest * (0.5 + 0.5 * Math.random()), signal);
    }
  }
}

/** Waits; throws when `signal` is raised. */
export function sleep(ms, signal = null) {
  return new Promise((resolve, reject) => {
    signal?.throwIfAborted();
    const stop = () => {
      clearTimeout(timer);
      reject(signal.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, ms);
    signal?.addEventListener("abort", stop, { once: true });
  });
}

/** A bake of a server. */
export class ServerSource {
  /** `http` in place of `base` and `token` shares one. */
  constructor({ base = "", token = null, bake, http = new Http({ base, token }) }) {
    this.http = http;
    this.bake = bake;
  }

  async manifest(signal = null) {
    const path = `/v1/bakes/${encodeURIComponent(this.bake)}/manifest`;
    return (await this.http.bytes(path, { bytesMax: MANIFEST_BYTES_MAX, signal })).bytes;
  }

  pathOf(digest) {
    return `/v1/chunks/${digest}`;
  }
}

/** A bundle folder: `manifest.json` and `chunks/<digest>`. */
export class BundleSource {
  constructor(base) {
    this.http = new Http({ base });
  }

  async manifest(signal = null) {
    return (await this.http.bytes("/manifest.json", { bytesMax: MANIFEST_BYTES_MAX, signal })).bytes;
  }

  pathOf(digest) {
    return `/chunks/${digest}`;
  }
}

/** The manifest of a bake with the clusters of its directory. */
export async function fetchManifest(source, { signal = null } = {}) {
  const manifest = readManifest(await source.manifest(signal));
  const pages = await fetchChunks(source, chunksOf(manifest, ROLES.directory), (bytes) => bytes, { signal });
  return withDirectory(manifest, pages);
}

/** Bytes of a chunk `{digest, bytes}`, verified. */
export async function fetchChunk(source, chunk, options = {}) {
  const bytes = await fetchUnverified(source, chunk, options);
  verify(chunk.digest, bytes);
  return bytes;
}

/** Bytes of a chunk that its decoder is to verify, as one in a Worker does. */
export async function fetchUnverified(source, chunk, { signal = null } = {}) {
  const { bytes } = await source.http.bytes(source.pathOf(chunk.digest), { bytesMax: chunk.bytes, signal });
  return bytes;
}

/** Fetches chunks, several at a time, and decodes each as it lands; results in their order. The first error ends it. */
export async function fetchChunks(source, chunks, decode, { parallel = PARALLEL, signal = null } = {}) {
  const results = new Array(chunks.length);
  const take = async (index) => {
    results[index] = decode(await fetchChunk(source, chunks[index], { signal }), index);
  };
  await forEachParallel(chunks.length, parallel, take);
  return results;
}

/**
 * Calls `take(index)` for 0…count − 1, `parallel` at a time. After the first error none is begun; it is thrown when those under way
 * have ended.
 */
export async function forEachParallel(count, parallel, take) {
  let next = 0;
  let failure = null;
  const run = async () => {
    while (next < count && failure === null) {
      await take(next++).catch((error) => (failure ??= { error }));
    }
  };
  await Promise.all(Array.from({ length: Math.min(parallel, count) }, run));
  if (failure !== null) throw failure.error;
}

/**
 * Fetches cluster `index` of a manifest with its directory, or as many of its `layers` as are asked for, and decodes it:
 * `{cluster, layer}`. A prefix is held against its check before it is decoded.
 */
export async function fetchCluster(source, manifest, index, { layers = Infinity, signal = null } = {}) {
  const row = manifest.clusters[index];
  const chunk = chunksOf(manifest, ROLES.clusters)[index];
  const wanted = Math.max(0, Math.min(layers, row.layers.length) - 1);
  if (wanted === row.layers.length - 1) {
    const cluster = decodeCluster(await fetchChunk(source, chunk, { signal }));
    return { cluster, layer: row.layers[wanted] };
  }
  const { bytes: range } = row.layers[wanted];
  const path = source.pathOf(chunk.digest);
  const { bytes, isPart } = await source.http.bytes(path, { bytesMax: chunk.bytes, range, signal });
  if (isPart) {
    verifyPrefix(row.checks[wanted], bytes);
    return decodeClusterPrefix(bytes, chunk.bytes);
  }
  verify(chunk.digest, bytes);
  return { cluster: decodeCluster(bytes), layer: row.layers.at(-1) };
}
