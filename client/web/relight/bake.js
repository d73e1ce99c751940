// A bake in memory: its scene, and its light in the flat tables that the passes bind; twin of client/src/scene and
// client/src/kinds/prt.

import { texturesOf } from "../chunk/manifest.js";
import { ClusterTable, EmitterTable } from "./clusters.js";
import { joinDraws } from "./draws.js";
import { Inconsistent } from "./inconsistent.js";
import { LightmapLayout } from "./layout.js";
import { LodTable } from "./lod_table.js";
import { NearTable } from "./near.js";
import { PatchTable } from "./patches.js";
import { ReceiverTable } from "./receivers.js";
import { SlotTable } from "./slots.js";
import { standIn } from "./stand_ins.js";
import { AtlasTexels } from "./texels.js";
import { TexelPoints } from "./texel_points.js";

// Kind of bake that is played here.
const KIND = "prt";

/** Manifest, meshes, textures as image files, and the lightmap's layout. Errs for what contradicts the manifest. */
export function assembleScene(manifest, geometry, textures) {
  if (manifest.kind !== KIND) {
    const problem = `it is of kind '${manifest.kind}', this page plays '${KIND}' alone; use kiln preview`;
    throw new Inconsistent("manifest", problem);
  }
  if (!manifest.lightmap) {
    throw new Inconsistent("manifest", "it has no lightmap");
  }
  const layout = new LightmapLayout(manifest);
  const { draws, warnings } = joinDraws(manifest, geometry, layout);
  checkTextures(manifest, textures.length);
  return { manifest, layout, draws, textures, warnings };
}

/**
 * Receivers, clusters, near hits and columns of decoded clusters. `isWhole` says that all of the bake's clusters are there; else
 * receivers stand for those that are absent.
 */
export function assembleLight(scene, clusters, patchSet, isWhole = true) {
  const slots = new SlotTable(scene.layout.blocks);
  const receivers = new ReceiverTable(clusters, slots);
  if (!isWhole) {
    standIn(patchSet, slots);
  }
  const columns = new PatchTable(patchSet, slots);
  const table = new ClusterTable(clusters, columns);
  return {
    slots,
    receivers,
    columns,
    clusters: table,
    emitters: new EmitterTable(clusters, scene.manifest.emitters.length),
    near: new NearTable(clusters, table, receivers, slots),
    texels: new AtlasTexels(scene.layout, slots, receivers),
    points: new TexelPoints(scene.draws, scene.layout, slots, receivers),
    lod: new LodTable(slots, receivers, table),
  };
}

function checkTextures({ materials }, count) {
  materials.forEach((material, index) => {
    for (const used of texturesOf(material)) {
      if (used.texture >= count) {
        throw new Inconsistent(`material ${index}`, `names texture ${used.texture} of ${count}`);
      }
    }
  });
}
