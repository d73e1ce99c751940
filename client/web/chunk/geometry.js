// Meshes to draw (chunk kind 3), FORMAT.md "Geometry".
//
// Decoded geometry mirrors `Geometry` of proto/src/content/drawing.rs; V vertices, vectors lie flat:
//
// {draws: [{
//   material,
//   front: BigInt or null, back: BigInt or null,       keys of blocks of the lightmap
//   positionM, normal: Float32Array(3V),
//   uv: Float32Array(2V) or empty, colour: Float32Array(4V) or empty,
//   lightmapTexel: Float32Array(2V), or empty outside the lightmap,
//   triangles: Uint32Array(3 · triangles),
// }]}

import { Reader } from "./bytes.js";
import { Container, sectionId } from "./container.js";
import { inRange } from "./error.js";
import { bytesMax, takeDeltas, takeU32s } from "./ints.js";
import { DRAWS_MAX, TRIANGLES_MAX, VERTICES_MAX } from "./limits.js";
import { putNormal } from "./numbers.js";
import { takeVectors, vectorsBytesMax } from "./vertices.js";

/** Number of the kind in a chunk's header. */
export const GEOMETRY = 3;
const SECTIONS = ["draws", "positions", "normals", "lightmap", "triangles", "uvs", "colours"];
const HAS_BACK = 1;
const HAS_UV = 2;
const HAS_COLOUR = 4;
const NO_LIGHTMAP = 8;
const FLAGS_MAX = 15;
/** Most raw bytes of a draw's entry: four numbers and two keys. */
const DRAW_BYTES_MAX = 4 * 4 + 2 * 8;
/** Memory that a decoded draw takes without its arrays: as in Rust, so that the same chunks are refused. */
const DRAW_DECODED_BYTES = 184;

/** Decodes a geometry chunk. */
export function decodeGeometry(bytes) {
  const container = new Container(GEOMETRY, bytes);
  const head = new Reader("geometry head", container.head);
  const count = (what, max) => inRange("geometry head", what, head.u32(what), 0, max);
  const draws = count("draws", DRAWS_MAX);
  const vertices = count("vertices", VERTICES_MAX);
  const triangles = count("triangles", TRIANGLES_MAX);
  head.end();
  container.checkSections(SECTIONS.map((_, index) => sectionId(index + 1)));
  container.checkExpansion(DRAW_DECODED_BYTES * draws + 56 * vertices + 12 * triangles);
  const raw = container.section(0, "draws", 4 + DRAW_BYTES_MAX * draws);
  const shapes = readShapes(raw, draws, vertices, triangles);
  SECTIONS.forEach((name, index) => {
    if (index === 0) return;
    const max = name === "triangles" ? bytesMax(3 * triangles) : vectorsBytesMax(vertices);
    const reader = new Reader(name, container.section(index, name, max));
    READERS[name](reader, shapes);
    reader.end();
  });
  return { draws: shapes.map(({ draw }) => draw) };
}

/** Draws without their arrays, and how long those are: `{draw, vertices, triangles, lightmap, uvs, colours}`. */
function readShapes(raw, count, vertices, triangles) {
  const section = "draws";
  const reader = new Reader(section, raw);
  const materials = takeU32s(reader, "material", count);
  const flags = takeU32s(reader, "flags", count);
  const vertexCounts = takeU32s(reader, "vertices of a draw", count);
  const triangleCounts = takeU32s(reader, "triangles of a draw", count);
  inRange(section, "vertices", sumOf(vertexCounts), vertices, vertices);
  inRange(section, "triangles", sumOf(triangleCounts), triangles, triangles);
  flags.forEach(checkFlags);
  const withFlag = (flag) => flags.filter((own) => own & flag).length;
  const fronts = reader.u64s("front block", count - withFlag(NO_LIGHTMAP));
  const backs = reader.u64s("back block", withFlag(HAS_BACK));
  reader.end();
  let [front, back] = [0, 0];
  return Array.from(flags, (own, index) => {
    const verticesIf = (isSet) => (isSet ? vertexCounts[index] : 0);
    const draw = {
      material: materials[index],
      front: own & NO_LIGHTMAP ? null : fronts[front++],
      back: own & HAS_BACK ? backs[back++] : null,
    };
    return {
      draw,
      vertices: vertexCounts[index],
      triangles: triangleCounts[index],
      lightmap: verticesIf(!(own & NO_LIGHTMAP)),
      uvs: verticesIf(own & HAS_UV),
      colours: verticesIf(own & HAS_COLOUR),
    };
  });
}

/** Throws on flags that mean nothing, and on a back block outside the lightmap. */
function checkFlags(flags) {
  inRange("draws", "flags", flags, 0, FLAGS_MAX);
  const both = NO_LIGHTMAP | HAS_BACK;
  inRange("draws", "back blocks outside the lightmap", (flags & both) === both ? 1 : 0, 0, 0);
}

function sumOf(counts) {
  return counts.reduce((sum, count) => sum + count, 0);
}

/** Reads of the sections after the first, each of which hands a shared array out to the draws. */
const READERS = {
  positions: (reader, shapes) => vectors(reader, shapes, { axes: 3, of: "vertices", to: "positionM", perUnit: 0 }),
  normals,
  lightmap: (reader, shapes) =>
    vectors(reader, shapes, { axes: 2, of: "lightmap", to: "lightmapTexel", perUnit: 256 }),
  triangles,
  uvs: (reader, shapes) => vectors(reader, shapes, { axes: 2, of: "uvs", to: "uv", perUnit: 0 }),
  colours: (reader, shapes) => vectors(reader, shapes, { axes: 4, of: "colours", to: "colour", perUnit: 255 }),
};

function vectors(reader, shapes, { axes, of, to, perUnit }) {
  const total = sumOf(shapes.map((shape) => shape[of]));
  handOut(takeVectors(reader, axes, total, perUnit), axes, shapes, of, to);
}

/** Copies each draw's share of a flat array to it. */
function handOut(all, axes, shapes, of, to) {
  let at = 0;
  for (const shape of shapes) {
    const end = at + axes * shape[of];
    shape.draw[to] = all.slice(at, end);
    at = end;
  }
}

function normals(reader, shapes) {
  const total = sumOf(shapes.map((shape) => shape.vertices));
  const [u, v] = [0, 1].map(() => takeDeltas(reader, "normal", total, -32_767, 32_767));
  const all = new Float32Array(3 * total);
  for (let index = 0; index < total; index++) putNormal(all, 3 * index, u[index], v[index]);
  handOut(all, 3, shapes, "vertices", "normal");
}

function triangles(reader, shapes) {
  const total = sumOf(shapes.map((shape) => shape.triangles));
  const corners = takeDeltas(reader, "vertex index", 3 * total, 0, VERTICES_MAX);
  handOut(new Uint32Array(corners.buffer), 3, shapes, "triangles", "triangles");
  for (const { draw, vertices } of shapes) {
    draw.triangles.forEach((index) => inRange("triangles", "vertex index + 1", index + 1, 1, vertices));
  }
}
