// The document of a glTF: JSON whose lists hold objects, indices that are followed with care, and bytes of buffers; twin of
// worker/src/scene/document.rs and buffers.rs.

import { fround } from "../relight/numbers.js";
import { ObjectError, broken, placeOf, shown } from "./error.js";
import { isGlb, splitGlb } from "./glb.js";
import { LIMITS, decodedLimit, within } from "./limits.js";
import { compressionOf, decompressed, isStandIn, readCompression } from "./meshopt.js";

// List of the document by the kind of its things.
const LISTS = {
  accessor: "accessors",
  animation: "animations",
  buffer: "buffers",
  "buffer view": "bufferViews",
  image: "images",
  material: "materials",
  mesh: "meshes",
  node: "nodes",
  sampler: "samplers",
  scene: "scenes",
  skin: "skins",
  texture: "textures",
};
// Extensions that are honoured, so that a file may require them.
const SUPPORTED = [
  "EXT_meshopt_compression",
  "KHR_lights_punctual",
  "KHR_materials_emissive_strength",
  "KHR_materials_pbrSpecularGlossiness",
  "KHR_materials_transmission",
  "KHR_mesh_quantization",
  "KHR_meshopt_compression",
  "KHR_texture_transform",
];
// Starts of names of extensions without which an object looks much as it is meant.
const HARMLESS = ["KHR_animation_", "KHR_materials_", "KHR_xmp", "EXT_mesh_features"];
const PERCENT = 0x25;
const COMPRESSED = /draco/;
const UNCOMPRESS = "convert it with 'npx @gltf-transform/cli copy IN.glb OUT.glb'";

export class GltfDocument {
  // Bytes of buffers by their index, once read.
  #buffers = new Map();
  // Bytes of compressed views by their index, once read, and how many they are.
  #decoded = new Map();
  #decodedBytes = 0;
  #decodedLimit;

  /** Reads the bytes of a `.glb`, or of a `.gltf` that has its buffers within. */
  constructor(bytes) {
    within(LIMITS.fileBytes, bytes.length);
    this.#decodedLimit = decodedLimit(bytes.length);
    const { json, bin } = isGlb(bytes) ? splitGlb(bytes) : { json: bytes, bin: null };
    within(LIMITS.jsonBytes, json.length);
    this.bin = bin;
    this.root = parse(json);
    checkVersion(this.root);
    checkExtensions(this.root);
    for (const [kind, name] of Object.entries(LISTS)) checkList(kind, this.root[name]);
  }

  /** Things of a kind, an object each. */
  list(kind) {
    return this.root[LISTS[kind]] ?? [];
  }

  /** Follows an index; `place` is a function that says who names it. */
  get(kind, index, place) {
    const list = this.list(kind);
    if (!Number.isInteger(index) || index < 0 || index >= list.length) {
      throw broken(place(), `names ${kind} ${shown(String(index))}, but the file has ${list.length}`);
    }
    return list[index];
  }

  /** Name in messages of a thing. */
  place(kind, index) {
    return placeOf(kind, index, this.list(kind)[index]?.name);
  }

  /** Bytes of a buffer view. */
  view(index, place) {
    const view = this.get("buffer view", index, place);
    const own = () => `buffer view ${index} of ${place()}`;
    const [buffer, offset, length] = [whole(view, "buffer", own), whole(view, "byteOffset", own, 0), whole(view, "byteLength", own)];
    const stated = compressionOf(view);
    // A view may be there uncompressed too.
    if (stated !== null && !this.#hasBytes(buffer)) {
      if (!this.#decoded.has(index)) this.#decoded.set(index, this.#decompressed(stated, own));
      return this.#decoded.get(index);
    }
    return this.#range(buffer, offset, length, own);
  }

  #decompressed(stated, place) {
    const compression = readCompression(stated, place);
    const { buffer, byteOffset, byteLength, byteStride, count } = compression;
    this.#decodedBytes += count * byteStride;
    within(this.#decodedLimit, this.#decodedBytes);
    const bytes = decompressed(this.#range(buffer, byteOffset, byteLength, place), compression);
    if (bytes === null) throw broken(place(), "its compressed bytes cannot be read");
    return bytes;
  }

  #range(buffer, offset, length, place) {
    const bytes = this.#buffer(buffer, place);
    const found = slice(bytes, offset, length);
    if (found === null) throw broken(place(), `it spans ${length} bytes from ${offset}, but its buffer has ${bytes.length}`);
    return found;
  }

  /** Whether a buffer is more than a stand-in for compressed views: files beside an object are not read, so one that names a file is none. */
  #hasBytes(index) {
    const buffer = this.list("buffer")[index];
    return buffer !== undefined && (isData(buffer.uri) || !isStandIn(buffer));
  }

  #buffer(index, place) {
    const buffer = this.get("buffer", index, place);
    const own = () => this.place("buffer", index);
    if (!this.#buffers.has(index)) this.#buffers.set(index, this.#bufferBytes(buffer, index, own));
    return this.#buffers.get(index);
  }

  #bufferBytes(buffer, index, place) {
    const stated = whole(buffer, "byteLength", place);
    let bytes = this.bin;
    if (buffer.uri !== undefined) {
      bytes = bytesOfUri(buffer.uri, place);
    } else if (isStandIn(buffer)) {
      throw broken(place(), "it has no bytes of its own, and the view does not say how they are compressed");
    } else if (index !== 0 || bytes === null) {
      throw broken(place(), "it has neither a URI nor a GLB chunk");
    }
    if (bytes.length < stated) throw broken(place(), `it states ${stated} bytes and has ${bytes.length}`);
    return bytes;
  }
}

/** `bytes[offset..offset + length]`, or null if that is not all there. */
export function slice(bytes, offset, length) {
  return offset + length <= bytes.length ? bytes.subarray(offset, offset + length) : null;
}

/** Whether a URI holds its bytes. */
function isData(uri) {
  return typeof uri === "string" && /^data:/i.test(uri);
}

/** Bytes of a data URI; files beside an object are not read. */
export function bytesOfUri(uri, place) {
  const data = typeof uri === "string" ? /^data:([^,]*),/i.exec(uri) : null;
  if (data === null) {
    throw new ObjectError(`${place()} points to '${shown(String(uri))}', which is not in the file; export as .glb`);
  }
  const payload = percentDecoded(uri.slice(data[0].length));
  const bytes = /;\s*base64\s*(;|$)/i.test(data[1]) ? bytesOfBase64(payload) : payload;
  if (bytes === null) throw new ObjectError(`the data URI of ${place()} is broken; export the file again`);
  return bytes;
}

/** Bytes of a text, of which `%` and two hex digits stand for one. */
function percentDecoded(text) {
  const bytes = new TextEncoder().encode(text);
  if (!text.includes("%")) return bytes;
  let length = 0;
  for (let at = 0; at < bytes.length; at++, length++) {
    const digits = bytes[at] === PERCENT ? String.fromCharCode(...bytes.subarray(at + 1, at + 3)) : "";
    const isCode = /^[0-9a-f]{2}$/i.test(digits);
    bytes[length] = isCode ? parseInt(digits, 16) : bytes[at];
    if (isCode) at += 2;
  }
  return bytes.subarray(0, length);
}

/** Bytes of base64, whose padding may be left out; null where it is none. */
function bytesOfBase64(payload) {
  const text = new TextDecoder().decode(payload);
  try {
    const decoded = atob(text);
    const unpadded = (base64) => base64.replace(/=+$/, "");
    // Blanks, and bits behind the last byte, are none of base64's.
    if (unpadded(btoa(decoded)) !== unpadded(text)) return null;
    return Uint8Array.from(decoded, (character) => character.charCodeAt(0));
  } catch {
    return null;
  }
}

/** A whole number of a thing, from 0; `absent` where there is none. */
export function whole(of, name, place, absent = undefined) {
  const value = of[name] ?? absent;
  if (Number.isSafeInteger(value) && value >= 0) return value;
  throw broken(place(), `its ${name} is ${value === undefined ? "missing" : "no whole number from 0"}`);
}

/** Numbers of a thing as f32, so many of them; `absent` where there are none. */
export function numbers(of, name, count, place, absent) {
  const stated = of[name];
  if (stated === undefined) return absent;
  // A list of JSON may lack elements, see `parse`.
  const values = Array.isArray(stated) ? Array.from(stated) : null;
  const isCount = values !== null && (count === null || values.length === count);
  if (isCount && values.every((value) => typeof value === "number")) return values.map(fround);
  throw broken(place(), `its ${name} has other than ${count ?? "only"} numbers`);
}

/** A number of a thing as an f32; `absent` where there is none. */
export function number(of, name, place, absent) {
  const value = of?.[name];
  if (value === undefined) return absent;
  if (typeof value === "number") return fround(value);
  throw broken(place(), `its ${name} is no number`);
}

/** An object of a thing, null where there is none. */
export function part(of, name, place) {
  const value = of?.[name];
  if (value === undefined) return null;
  if (isObject(value)) return value;
  throw broken(place(), `its ${name} is no object`);
}

/** A list of a thing, empty where there is none. */
export function listOf(of, name, place) {
  const value = of[name];
  if (value === undefined) return [];
  if (Array.isArray(value)) return Array.from(value);
  throw broken(place(), `its ${name} is no list`);
}

function isObject(value) {
  return typeof value === "object" && value !== null && !Array.isArray(value);
}

function parse(bytes) {
  let root = null;
  try {
    const text = new TextDecoder("utf-8", { fatal: true }).decode(bytes);
    // A member that is null is as good as none.
    root = JSON.parse(text, (_, value) => (value === null ? undefined : value));
  } catch {
    throw new ObjectError("this is no .glb, or its JSON cannot be read; export the object as .glb");
  }
  if (!isObject(root) || !isObject(root.asset)) throw new ObjectError("the JSON is not glTF 2.0; export the file again");
  return root;
}

function checkVersion({ asset }) {
  const needed = asset.minVersion ?? asset.version;
  const isTwo = needed === "2.0" || (asset.minVersion === undefined && typeof needed === "string" && needed.startsWith("2."));
  if (!isTwo) throw new ObjectError(`glTF version ${shown(String(needed))} is not supported; export the object as glTF 2.0`);
}

function checkExtensions(root) {
  const required = listOf(root, "extensionsRequired", () => "the file");
  const isFatal = (name) => !SUPPORTED.includes(name) && !HARMLESS.some((start) => String(name).startsWith(start));
  const fatal = required.find(isFatal);
  if (fatal === undefined) return;
  const advice = COMPRESSED.test(fatal) ? UNCOMPRESS : "export the object without it";
  throw new ObjectError(`the file requires the extension ${shown(String(fatal))}, which is not supported; ${advice}`);
}

function checkList(kind, list) {
  if (list === undefined) return;
  if (!Array.isArray(list)) throw broken("the file", `its ${LISTS[kind]} are no list`);
  const bad = list.findIndex((thing) => !isObject(thing));
  if (bad >= 0) throw broken(`${kind} ${bad}`, "it is no object");
}
