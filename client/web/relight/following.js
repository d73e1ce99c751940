// A bake of a server that goes on, followed by its results: its outline, and the clusters of its cells as they land. Twin of
// client/src/fetch/following.rs.
//
//   const following = new Following(new ServerSource({ bake: "3f2a…", token }));
//   while ((await following.hear({ waitSecs: 25 })) !== "done") { … following.manifest, following.cells … }

import { decodeDirectory } from "../chunk/directory.js";
import { ChunkError } from "../chunk/error.js";
import { CLUSTERS_MAX, PAGE_BYTES_MAX, ROLES, checkRelightable, chunksOf, readManifest } from "../chunk/manifest.js";
import { FetchError, PARALLEL, fetchChunk, forEachParallel } from "../fetch.js";
import { Inconsistent } from "./inconsistent.js";

/** Tasks of a bake whose results are followed: of the one that gives the outline, and of those that give a page each. */
export const TASKS = { outline: "prt.plan", clusters: "prt.colour" };
const OUTPUTS = { outline: "outline", page: "page" };

export class Following {
  #source;
  // Places up to which no result is left to take: of the outline's task, and of cells.
  #after = { outline: 0, cells: 0 };
  #cells = new Set();
  #cellsAll = 0;

  constructor(source) {
    this.#source = source;
    /** The outline with the clusters that have landed, in the order in which they did; null before it has come. */
    this.manifest = null;
  }

  /** Cells whose clusters are listed, and all cells. One whose page is lost is not among the first. */
  get cells() {
    return [this.#cells.size, Math.max(this.#cellsAll, this.#cells.size)];
  }

  /**
   * Takes what has landed since the last call, waiting for it: "none", "more" where the outline or clusters have come, "done" where the
   * bake is, whose own manifest tells the rest. Throws for a bake that ended without all of its light.
   */
  async hear({ waitSecs = 0, signal = null } = {}) {
    let [wait, news] = [waitSecs, "none"];
    if (this.manifest === null) {
      const { results, nextAfter, isDone } = await this.#results(TASKS.outline, this.#after.outline, wait, signal);
      if (isDone) return "done";
      if (results.length === 0) {
        this.#after.outline = nextAfter;
        return "none";
      }
      this.manifest = await this.#outline(results.at(-1), signal);
      [wait, news] = [0, "more"];
    }
    for (;;) {
      const { results, nextAfter, isDone } = await this.#results(TASKS.clusters, this.#after.cells, wait, signal);
      if (isDone) return "done";
      if (results.length > 0) await this.#take(results, signal);
      this.#after.cells = nextAfter;
      if (results.length === 0) return news;
      [wait, news] = [0, "more"];
    }
  }

  async #results(kind, after, waitSecs, signal) {
    const { http, bake: id } = this.#source;
    const path = `/v1/bakes/${encodeURIComponent(id)}/results?kind=${kind}&after=${after}&wait_secs=${waitSecs}`;
    const { results, next_after: nextAfter, bake } = await http.json(path, { signal });
    if (bake.state === "failed") throw new Error(`the bake failed: ${bake.failure ?? "no reason was given"}`);
    if (bake.state === "cancelled") throw new Error("the bake was cancelled");
    if (!Number.isSafeInteger(nextAfter) || (results.length > 0 && nextAfter <= after)) {
      throw new Inconsistent(`results of ${kind}`, `they end at place ${nextAfter}, though they lie behind ${after}`);
    }
    this.#cellsAll = bake.stages.find((stage) => stage.kind === TASKS.clusters)?.total ?? 0;
    return { results, nextAfter, isDone: bake.state === "done" };
  }

  async #outline(result, signal) {
    if (result.outputs.every(({ name }) => name !== OUTPUTS.outline)) {
      throw new Error("the bake goes on by a plan of an earlier version, which tells of no light before the end: it is seen once it is done");
    }
    const outline = readManifest(await fetchChunk(this.#source, outputOf(result, OUTPUTS.outline), { signal }));
    if (outline.directory.length > 0) throw new Inconsistent("outline", "it has a directory");
    checkRelightable(outline);
    return outline;
  }

  /** Lists the clusters of cells behind the others. A page whose bytes were lost comes again once its task has run again. */
  async #take(results, signal) {
    const fresh = [...new Map(results.map((result) => [result.key, result])).values()];
    const wanted = fresh.filter(({ key }) => !this.#cells.has(key));
    const pages = new Array(wanted.length);
    await forEachParallel(wanted.length, PARALLEL, async (at) => {
      pages[at] = await this.#page(wanted[at], signal);
    });
    const clusters = [...this.manifest.clusters];
    const chunks = [...chunksOf(this.manifest, ROLES.clusters)];
    pages.forEach((page, at) => {
      if (page === null) return;
      this.#cells.add(wanted[at].key);
      clusters.push(...page.rows);
      chunks.push(...page.chunks);
    });
    if (clusters.length > CLUSTERS_MAX) throw new Inconsistent("pages", `they list more than ${CLUSTERS_MAX} clusters`);
    this.manifest = { ...this.manifest, clusters, chunks: new Map(this.manifest.chunks).set(ROLES.clusters, chunks) };
  }

  async #page(result, signal) {
    const chunk = outputOf(result, OUTPUTS.page);
    if (chunk.bytes > PAGE_BYTES_MAX) throw new Inconsistent(`page of ${result.label}`, `it has ${chunk.bytes} bytes`);
    try {
      return decodeDirectory(await fetchChunk(this.#source, chunk, { signal }));
    } catch (error) {
      if (isLost(error)) return null;
      throw error;
    }
  }
}

/**
 * Whether an error is that a server has no bytes of that name, or others in their place: while a bake goes on they come again, once their
 * task has run again.
 */
export function isLost(error) {
  const isGone = error instanceof FetchError && error.status === 404;
  return isGone || (error instanceof ChunkError && error.code === "digest");
}

function outputOf({ kind, label, outputs }, name) {
  const found = outputs.find((output) => output.name === name);
  if (found !== undefined) return { digest: found.digest, bytes: found.bytes };
  throw new Inconsistent(`task ${kind} '${label}'`, `it has no output '${name}': a worker of another version ran it`);
}

/** Throws unless a bake's manifest is of the scene, the settings and the chunks that its outline had. */
export function checkOutline(outline, whole) {
  if (earlyOf(outline) === earlyOf(whole)) return;
  throw new Inconsistent("manifest", "it is not that of the outline which its bake gave while it went on: open the page again");
}

/** A manifest but for what its clusters bring, as text. */
function earlyOf({ clusters, directory, body, chunks, ...rest }) {
  const late = [ROLES.clusters, ROLES.directory, ROLES.overview];
  const early = [...chunks].filter(([role]) => !late.includes(role));
  // Keys of blocks are whole numbers of 64 bits.
  const plain = (_, value) => {
    if (typeof value === "bigint") return String(value);
    return ArrayBuffer.isView(value) ? [...value] : value;
  };
  return JSON.stringify([rest, early], plain);
}
