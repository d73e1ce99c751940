// Meshes to draw, checked and interleaved for the adapter; twin of client/src/scene/draws.rs.

import { Inconsistent } from "./inconsistent.js";
import { allFinite } from "./numbers.js";
import { NO_BLOCK } from "./layout.js";

/** Numbers of a vertex: position, normal, uv, colour, lightmap coordinates in texels of the block. */
export const VERTEX_NUMBERS = 14;
export const POSITION = 0;
export const NORMAL = 3;
export const UV = 6;
export const COLOUR = 8;
export const LIGHTMAP_TEXEL = 12;

/** Draws of decoded geometry chunks, and warnings about those that are drawn with less than they need. */
export function joinDraws(manifest, contents, layout) {
  const draws = contents.flatMap((geometry) => geometry.draws).map((draw, index) => {
    const problem = problemOf(draw, manifest);
    if (problem !== null) {
      throw new Inconsistent(`draw ${index}`, problem);
    }
    const blockOf = (key) => (key === null || key === undefined ? NO_BLOCK : layout.blockIndex(key));
    return {
      material: draw.material,
      front: blockOf(draw.front),
      back: blockOf(draw.back),
      vertices: interleaved(draw),
      triangles: draw.triangles,
    };
  });
  const without = draws.filter(({ front }) => front === NO_BLOCK).length;
  const warnings =
    without > 0 && layout.blocks.length > 0
      ? [`${without} meshes have no receivers and are drawn without indirect light`]
      : [];
  return { draws, warnings };
}

/** Vertices of a draw as the adapter reads them. */
export function interleaved(draw) {
  const count = draw.positionM.length / 3;
  const vertices = new Float32Array(VERTEX_NUMBERS * count);
  const put = (place, each, values, absent) => {
    const all = values !== undefined && values.length > 0;
    for (let vertex = 0; vertex < count; vertex++) {
      for (let i = 0; i < each; i++) {
        vertices[vertex * VERTEX_NUMBERS + place + i] = all ? values[vertex * each + i] : absent;
      }
    }
  };
  put(POSITION, 3, draw.positionM, 0);
  put(NORMAL, 3, draw.normal, 0);
  put(UV, 2, draw.uv, 0);
  put(COLOUR, 4, draw.colour, 1);
  put(LIGHTMAP_TEXEL, 2, draw.lightmapTexel, 0);
  return vertices;
}

/** Why a draw contradicts the manifest or itself; null where it does not. */
export function problemOf(draw, manifest) {
  const count = draw.positionM.length / 3;
  const optional = (values, each) => values.length === 0 || values.length === each * count;
  const texels = draw.front === null || draw.front === undefined ? 0 : 2 * count;
  const differs =
    draw.normal.length !== 3 * count ||
    draw.lightmapTexel.length !== texels ||
    !optional(draw.uv, 2) ||
    !optional(draw.colour, 4);
  if (differs) {
    return "its vertex arrays differ in length";
  }
  if (draw.material >= manifest.materials.length) {
    return `names material ${draw.material} of ${manifest.materials.length}`;
  }
  if (draw.triangles.some((index) => index >= count)) {
    return `a triangle names a vertex above ${count}`;
  }
  const vectors = [draw.positionM, draw.normal, draw.lightmapTexel, draw.uv, draw.colour];
  return vectors.every(allFinite) ? null : "a vertex has a number that is not finite";
}
