// The manifest of a bake: its scene, settings, lights, cameras and chunks, and a body that its kind reads.
//
// A manifest that was read mirrors `Manifest` of proto/src/manifest/mod.rs in camelCase; JSON's null is null:
//
// {
//   format, version, kind, scene: hex, settings: JSON as it is, boundsM: Float32Array(6), triangles,
//   lightmap: {texelM, pages: [[width, height]], blocks: [{key: BigInt, name, size: [w, h], page, origin: [x, y]}]} or null,
//   materials: [{name, baseColour: Float32Array(4), baseColourTexture: USE or null, emissive: Float32Array(3),
//     emissiveTexture: USE or null, emitter: index or null, alphaCutoff: number or null,
//     glass: {blends, transmission, transmissionTexture: USE or null} or null, normalMap: {texture: USE, scale} or null,
//     specular: {metallic, roughness, texture: USE or null} or null, doubleSided}],
//     where USE is {texture, wrap: ["repeat", "clamp" or "mirror", …], transform: [Float32Array(3), Float32Array(3)] or null}
//   emitters: [{name, areaM2}],
//   lights: [{name, kind: {type: "point", positionM, rangeM} | {type: "spot", positionM, direction, innerRad, outerRad, rangeM}
//     | {type: "sun", direction} | {type: "rect", positionM, direction, up, sizeM, points} | {type: "sky", zenith, horizon},
//     strength}], where vectors are Float32Array(3)
//   cameras: [{name, eyeM, targetM, up, fovYRad, orthographicHalfHeightM}],
//   framing: {camera: {value, note} or null, light: {value, note} or null},
//   chunks: Map from role to [{digest: hex, bytes}],
//   directory: [{boundsM, clusters}],
//   clusters: rows of `directory.js`, row i of the i-th chunk of role "clusters"; filled by `withDirectory`,
//   body: JSON as it is,
// }

import { isDigest } from "./digest.js";
import { decodeDirectory } from "./directory.js";
import { ChunkError } from "./error.js";
import {
  FieldError, any, bounds, f32, f64, flag, listOf, mapOf, object, oneOf, optional, orElse, tagged, text, vector, whole,
} from "./fields.js";
import { CHUNK_BYTES_MAX, DIRECTORY_CLUSTERS_MAX } from "./limits.js";

export const FORMAT = "lightkiln-manifest";
export const VERSION = 3;
/** Roles of chunks. */
export const ROLES = {
  clusters: "clusters",
  overview: "overview",
  directory: "directory",
  textures: "textures",
  geometry: "geometry",
  patches: "patches",
};
const MANIFEST_BYTES_MAX = 256 * 2 ** 20;
export const PAGE_BYTES_MAX = 2 ** 20;
export const CLUSTERS_MAX = 2 ** 20;
const U16_MAX = 0xffff;
const U32_MAX = 0xffff_ffff;

/** Why bytes are no manifest, or one that cannot be used; `code` is `json`, `format`, `field`, `kind`, `contradiction` or `page`. */
export class ManifestError extends Error {
  constructor(code, message, cause) {
    super(message, cause === undefined ? undefined : { cause });
    this.name = "ManifestError";
    this.code = code;
  }
}

const count = whole(U32_MAX);
const colour = vector(3);
const pair = listOf(count, 2);

function digest(value, where) {
  if (!isDigest(value)) throw new FieldError(`${where} is not a blake3 digest (64 lower-case hex digits)`);
  return value;
}

function blockKey(value, where) {
  if (typeof value !== "string" || !/^[0-9a-f]{16}$/.test(value)) {
    throw new FieldError(`${where} is not 16 lower-case hex digits`);
  }
  return BigInt(`0x${value}`);
}

const lightmap = object({
  texel_m: f32,
  pages: listOf(pair),
  blocks: listOf(object({ key: blockKey, name: text, size: pair, page: count, origin: pair })),
});

const wrap = oneOf("repeat", "clamp", "mirror");
const textureUse = object({
  texture: count,
  wrap: listOf(wrap, 2),
  transform: optional(listOf(vector(3), 2)),
});

const material = object({
  name: text,
  base_colour: vector(4),
  base_colour_texture: optional(textureUse),
  emissive: colour,
  emissive_texture: optional(textureUse),
  emitter: optional(whole(U16_MAX)),
  alpha_cutoff: optional(f32),
  glass: optional(object({ blends: flag, transmission: f32, transmission_texture: optional(textureUse) })),
  normal_map: optional(object({ texture: textureUse, scale: f32 })),
  specular: optional(object({ metallic: f32, roughness: f32, texture: optional(textureUse) })),
  double_sided: flag,
});

/** Textures of a material that it reads as colours. */
export function colourTextures({ baseColourTexture, emissiveTexture, glass }) {
  return [baseColourTexture, emissiveTexture, glass?.transmissionTexture].filter((used) => used);
}

/** Textures of a material that it reads as linear numbers. */
export function numberTextures({ normalMap, specular }) {
  return [normalMap?.texture, specular?.texture].filter((used) => used);
}

/** All textures of a material. */
export function texturesOf(material) {
  return [...colourTextures(material), ...numberTextures(material)];
}

const light = object({
  name: text,
  kind: tagged("type", {
    point: { position_m: vector(3), range_m: optional(f32) },
    spot: {
      position_m: vector(3),
      direction: vector(3),
      inner_rad: f32,
      outer_rad: f32,
      range_m: optional(f32),
    },
    sun: { direction: vector(3) },
    rect: { position_m: vector(3), direction: vector(3), up: vector(3), size_m: vector(2), points: count },
    sky: { zenith: colour, horizon: colour },
  }),
  strength: colour,
});

const camera = object({
  name: text,
  eye_m: vector(3),
  target_m: vector(3),
  up: vector(3),
  fov_y_rad: f32,
  orthographic_half_height_m: optional(f32),
});

const manifest = object({
  format: text,
  version: count,
  kind: text,
  scene: digest,
  settings: any,
  bounds_m: bounds,
  triangles: whole(Number.MAX_SAFE_INTEGER),
  lightmap: optional(lightmap),
  materials: listOf(material),
  emitters: listOf(object({ name: text, area_m2: f64 })),
  lights: listOf(light),
  cameras: listOf(camera),
  framing: object({
    camera: optional(object({ value: camera, note: text })),
    light: optional(object({ value: light, note: text })),
  }),
  chunks: mapOf(listOf(object({ digest, bytes: whole(Number.MAX_SAFE_INTEGER) }))),
  directory: orElse(listOf(object({ bounds_m: bounds, clusters: count })), () => []),
  body: any,
});

/** Reads a manifest from the bytes of its JSON, but for its clusters, see `withDirectory`. */
export function readManifest(bytes) {
  const json = parse(bytes);
  const { format, version } = json ?? {};
  if (format !== FORMAT || version !== VERSION) {
    const found = `its format is '${String(format).slice(0, 40)}' version ${String(version).slice(0, 40)}`;
    const wanted = `wanted '${FORMAT}' version ${VERSION}`;
    throw new ManifestError("format", `${found}, ${wanted}: use the kiln that wrote it, or bake the scene again`);
  }
  const found = { ...read(json), clusters: [] };
  checkLengths(found);
  checkDirectory(found);
  return found;
}

function parse(bytes) {
  if (bytes.length > MANIFEST_BYTES_MAX) {
    throw new ManifestError("json", `it has ${bytes.length} bytes, and no manifest has more than ${MANIFEST_BYTES_MAX}`);
  }
  try {
    return JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes));
  } catch (cause) {
    throw new ManifestError("json", "it is no manifest", cause);
  }
}

function read(json) {
  try {
    return manifest(json, "");
  } catch (cause) {
    if (!(cause instanceof FieldError)) throw cause;
    throw new ManifestError("field", `it is no manifest: ${cause.message}`, cause);
  }
}

/** Chunks of a role; none where the bake has no such role. */
export function chunksOf(manifest, role) {
  return manifest.chunks.get(role) ?? [];
}

function checkLengths({ chunks }) {
  for (const [role, ofRole] of chunks) {
    const long = ofRole.find(({ bytes }) => bytes > CHUNK_BYTES_MAX);
    if (long === undefined) continue;
    const most = `none has more than ${CHUNK_BYTES_MAX}`;
    throw contradiction(`a chunk of '${role.slice(0, 40)}' has ${long.bytes} bytes, and ${most}: it is damaged`);
  }
}

/** Throws unless each page has a chunk of its own, and they hold no more than can be read. */
function checkDirectory(found) {
  const [pages, chunks] = [found.directory, chunksOf(found, ROLES.directory)];
  const clusters = pages.reduce((sum, page) => sum + page.clusters, 0);
  const isPage = (page) => page.clusters >= 1 && page.clusters <= DIRECTORY_CLUSTERS_MAX;
  const problems = [
    [found.chunks.has(ROLES.clusters), `it names '${ROLES.clusters}' beside its directory`],
    [pages.length !== chunks.length, `its directory has ${pages.length} pages and ${chunks.length} chunks of them`],
    [new Set(chunks.map((chunk) => chunk.digest)).size !== chunks.length, "its directory has a page twice"],
    [
      !pages.every(isPage) || clusters > CLUSTERS_MAX,
      `its directory has ${clusters} clusters; a page has 1 to ${DIRECTORY_CLUSTERS_MAX}, all ${CLUSTERS_MAX}`,
    ],
    [
      chunks.some((chunk) => chunk.bytes > PAGE_BYTES_MAX),
      `its directory has a page of more than ${PAGE_BYTES_MAX} bytes`,
    ],
  ];
  const wrong = problems.find(([isWrong]) => isWrong);
  if (wrong !== undefined) throw contradiction(`${wrong[1]}: it is damaged`);
}

function contradiction(problem) {
  return new ManifestError("contradiction", problem);
}

/** The manifest with the clusters of its directory, of which `pages` are the bytes of all pages in order. */
export function withDirectory(found, pages) {
  if (pages.length !== found.directory.length) {
    throw contradiction(`its directory has ${found.directory.length} pages, and ${pages.length} were read`);
  }
  const [rows, chunks] = [[], []];
  pages.forEach((bytes, index) => {
    const page = readPage(bytes, index);
    checkPage(page, found.directory[index], index);
    rows.push(...page.rows);
    chunks.push(...page.chunks);
  });
  const all = new Map(found.chunks);
  if (rows.length > 0) all.set(ROLES.clusters, chunks);
  return { ...found, chunks: all, clusters: rows };
}

function readPage(bytes, index) {
  try {
    return decodeDirectory(bytes);
  } catch (cause) {
    if (!(cause instanceof ChunkError)) throw cause;
    const next = "fetch the bake again, or bake it again";
    throw new ManifestError("page", `page ${index} of its directory is damaged: ${next}`, cause);
  }
}

function checkPage({ rows }, listed, index) {
  const outer = (column) => (column < 3 ? Math.min : Math.max);
  const boundsOf = (column) => rows.map((row) => row.boundsM[column]).reduce((a, b) => outer(column)(a, b));
  const isListed = rows.length === listed.clusters && listed.boundsM.every((bound, column) => boundsOf(column) === bound);
  if (isListed) return;
  const problem = `has ${rows.length} clusters, wanted ${listed.clusters}, or other bounds than it says`;
  throw contradiction(`page ${index} of its directory ${problem}`);
}

/**
 * Throws unless the manifest is one of the kind `prt` that can be relit: with a lightmap, one set of patches, and as many clusters
 * as its body says. Its directory has been read.
 */
export function checkRelightable(found) {
  if (found.kind !== "prt") {
    throw new ManifestError("kind", `it is of kind '${found.kind.slice(0, 40)}'; the browser relights kind prt`);
  }
  if (found.lightmap === null) throw contradiction("it has no lightmap");
  const wanted = found.body?.totals?.clusters;
  if (found.clusters.length !== wanted) {
    throw contradiction(`its directory has ${found.clusters.length} clusters, wanted ${wanted}`);
  }
  const sets = chunksOf(found, ROLES.patches).length;
  if (sets !== 1) throw contradiction(`it has ${sets} sets of surface patches, wanted 1`);
}
