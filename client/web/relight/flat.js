// Values on their way between threads: tables of light as plain values and back, the memory that goes with them, and errors.

import { ChunkError } from "../chunk/error.js";
import { ClusterTable, EmitterTable } from "./clusters.js";
import { Inconsistent } from "./inconsistent.js";
import { LodTable } from "./lod_table.js";
import { NearTable } from "./near.js";
import { PatchTable } from "./patches.js";
import { ReceiverTable } from "./receivers.js";
import { AtlasTexels } from "./texels.js";
import { TexelPoints } from "./texel_points.js";

const TABLES = {
  receivers: ReceiverTable,
  columns: PatchTable,
  clusters: ClusterTable,
  emitters: EmitterTable,
  near: NearTable,
  texels: AtlasTexels,
  points: TexelPoints,
  lod: LodTable,
};
const ERRORS = { ChunkError, Inconsistent };

/** The tables of a light (`assembleLight`) as plain values, none of whose memory is a decoded chunk's. */
export function flatLight(light) {
  const flat = Object.fromEntries(Object.keys(TABLES).map((name) => [name, { ...light[name] }]));
  flat.columns.leafStarts = flat.columns.leafStarts.slice();
  flat.emitters.parts = flat.emitters.parts.map((part) => ({ ...part, irradiance: part.irradiance.slice() }));
  return flat;
}

/** The tables of plain values, for frames: their columns are not found by keys. */
export function lightOf(flat) {
  const table = ([name, Table]) => [name, Object.assign(Object.create(Table.prototype), flat[name])];
  return Object.fromEntries(Object.entries(TABLES).map(table));
}

/** Buffers of all arrays in a tree of plain values, each once. */
export function buffersOf(value, found = new Set()) {
  if (ArrayBuffer.isView(value)) found.add(value.buffer);
  else if (Array.isArray(value)) value.forEach((item) => buffersOf(item, found));
  else if (typeof value === "object" && value !== null) Object.values(value).forEach((item) => buffersOf(item, found));
  return [...found];
}

/** An error as plain values. */
export function flatError(error) {
  return { ...error, name: error?.name ?? "Error", message: error?.message ?? String(error) };
}

/** The error of plain values, of its own class where that is one of chunks or bakes. */
export function errorOf({ name, message, ...fields }) {
  const error = Object.assign(new Error(message), fields, { name });
  const Known = ERRORS[name];
  return Known === undefined ? error : Object.setPrototypeOf(error, Known.prototype);
}
