// Decodes chunks that a test serves, and tells fields and verdicts as `fields.rs` and `decoding.rs` have them.

import { decodeClusterPrefix } from "/web/chunk/cluster.js";
import { digestOf, hexOf } from "/web/chunk/digest.js";
import { ChunkError } from "/web/chunk/error.js";
import { decodeChunk } from "/web/chunk/table.js";

/** Fields of decoded content by path; numbers of arrays by their bytes. */
function fieldsOf(content, path = "", fields = {}) {
  for (const [name, value] of Object.entries(content)) {
    const place = path === "" ? name : `${path}.${name}`;
    if (ArrayBuffer.isView(value)) {
      fields[place] = hexOf(new Uint8Array(value.buffer, value.byteOffset, value.byteLength));
    } else if (typeof value === "number") {
      fields[place] = hexOf(new Uint8Array(Float64Array.of(value).buffer));
    } else if (typeof value === "bigint") {
      fields[place] = value.toString(16);
    } else if (typeof value === "object" && value !== null) {
      fieldsOf(value, place, fields);
    } else {
      fields[place] = String(value);
    }
  }
  return fields;
}

async function bytesOf(url) {
  return new Uint8Array(await (await fetch(url)).arrayBuffer());
}

/** Fields of the chunk at `url`. */
export async function fields(url) {
  return fieldsOf(decodeChunk(await bytesOf(url)).content);
}

/** Fields and layer of the first bytes of the cluster at `url`. */
export async function prefixFields(url, bytes) {
  const all = await bytesOf(url);
  const { cluster, layer } = decodeClusterPrefix(all.subarray(0, bytes), all.length);
  return { fields: fieldsOf(cluster), layer };
}

/** Verdicts on the inputs at `url`, each a length of four bytes and its bytes, and the longest time that one took. */
export async function verdicts(url) {
  const all = await bytesOf(url);
  const view = new DataView(all.buffer);
  const told = [];
  let longestMs = 0;
  for (let at = 0; at < all.length; ) {
    const length = view.getUint32(at, true);
    const input = all.slice(at + 4, at + 4 + length);
    at += 4 + length;
    const start = performance.now();
    told.push(verdict(input));
    longestMs = Math.max(longestMs, performance.now() - start);
  }
  return { told, longestMs };
}

function verdict(input) {
  try {
    const fields = fieldsOf(decodeChunk(input).content);
    const lines = Object.keys(fields).sort().map((name) => `${name}=${fields[name]}\n`);
    return `taken ${digestOf(new TextEncoder().encode(lines.join("")))}`;
  } catch (error) {
    if (error instanceof ChunkError) return `${error.code}: ${error.message}`;
    return `fault: ${error?.stack ?? error}`;
  }
}
