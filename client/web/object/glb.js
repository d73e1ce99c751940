// The GLB container: a 12-byte header, a JSON chunk, then at most one binary chunk; twin of worker/src/scene/glb.rs.

import { ObjectError } from "./error.js";

const MAGIC = 0x46546c67;
const JSON_CHUNK = 0x4e4f534a;
const BIN_CHUNK = 0x004e4942;
const HEADER_BYTES = 12;
const CHUNK_HEADER_BYTES = 8;
const VERSION = 2;

/** Whether these bytes claim to be a GLB. */
export function isGlb(bytes) {
  return bytes.length >= 4 && viewOf(bytes).getUint32(0, true) === MAGIC;
}

/** The JSON of a GLB and its binary chunk, null where it has none. Errs on lengths beyond the file and on another version. */
export function splitGlb(bytes) {
  if (bytes.length < HEADER_BYTES) throw fault("it ends inside its header");
  const view = viewOf(bytes);
  const [version, stated] = [view.getUint32(4, true), view.getUint32(8, true)];
  if (version !== VERSION) throw new ObjectError(`glTF version ${version} is not supported; export the object as glTF 2.0`);
  if (stated > bytes.length || stated < HEADER_BYTES) throw fault(`it states ${stated} bytes and has ${bytes.length}`);
  const chunks = chunksOf(bytes.subarray(HEADER_BYTES, stated));
  if (chunks[0]?.kind !== JSON_CHUNK) throw fault("its first chunk is not JSON");
  const bin = chunks.slice(1).find(({ kind }) => kind === BIN_CHUNK);
  return { json: chunks[0].body, bin: bin?.body ?? null };
}

function chunksOf(bytes) {
  const view = viewOf(bytes);
  const chunks = [];
  let at = 0;
  // Fewer bytes than a chunk's header are padding that some exporters leave.
  while (bytes.length - at >= CHUNK_HEADER_BYTES) {
    const [length, left] = [view.getUint32(at, true), bytes.length - at - CHUNK_HEADER_BYTES];
    if (length > left) throw fault(`a chunk states ${length} bytes and ${left} are left`);
    const start = at + CHUNK_HEADER_BYTES;
    chunks.push({ kind: view.getUint32(at + 4, true), body: bytes.subarray(start, start + length) });
    at = start + length;
  }
  return chunks;
}

function viewOf({ buffer, byteOffset, byteLength }) {
  return new DataView(buffer, byteOffset, byteLength);
}

function fault(problem) {
  return new ObjectError(`broken GLB: ${problem}; export the file again`);
}
