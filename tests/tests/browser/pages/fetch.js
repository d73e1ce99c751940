// Fetches a bake that a test serves, and tells of what came.

import { decodePatches } from "/web/chunk/patches.js";
import { chunksOf } from "/web/chunk/manifest.js";
import { BundleSource, fetchChunks, fetchCluster, fetchManifest } from "/web/fetch.js";

/** Clusters, receivers of the first layer and of the whole of each, and patches of the bundle at `base`. */
export async function bake(base) {
  const source = new BundleSource(base);
  const manifest = await fetchManifest(source);
  const [patches] = await fetchChunks(source, chunksOf(manifest, "patches"), decodePatches);
  const receivers = [];
  for (let index = 0; index < manifest.clusters.length; index++) {
    const first = await fetchCluster(source, manifest, index, { layers: 1 });
    const whole = await fetchCluster(source, manifest, index);
    receivers.push([first.cluster.receivers.length, whole.cluster.receivers.length]);
  }
  return { kind: manifest.kind, receivers, patches: patches.patches.length };
}

/** Name, code and words of the error that `bake` ends with. */
export async function failure(base) {
  try {
    return `no error: ${JSON.stringify(await bake(base))}`;
  } catch (error) {
    return `${error.name} ${error.code}: ${error.message}`;
  }
}
