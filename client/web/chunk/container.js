// The container that all kinds of chunk share: header, section table, sections.

import { ZstdError, unpack } from "../zstd/frame.js";
import { Reader } from "./bytes.js";
import { ChunkError, inRange } from "./error.js";
import {
  CHUNK_BYTES_MAX, EXPANSION_FREE_BYTES, EXPANSION_MAX, HEAD_BYTES_MAX, SECTIONS_MAX,
} from "./limits.js";

const MAGIC = [0x4c, 0x4b, 0x43, 0x48];
/** The version that is read; bakes of older ones are to be made again. */
export const VERSION = 4;
const ENTRY_BYTES = 12;

/** Identity of a section: its tag and three part numbers. */
export function sectionId(tag, part = [0, 0, 0]) {
  return { tag, part };
}

/** A chunk whose header and section table have been read and checked. */
export class Container {
  /** Reads a chunk of `kind` of which `bytes` are the first and `totalBytes` all; without the latter all are there. */
  constructor(kind, bytes, totalBytes = bytes.length) {
    const section = "header";
    inRange(section, "chunk length", totalBytes, bytes.length, CHUNK_BYTES_MAX);
    const reader = new Reader(section, bytes);
    const { headBytes, sectionCount } = readFixed(kind, reader);
    this.bytes = bytes;
    /** The kind's own head. */
    this.head = reader.take("head", headBytes);
    const table = new Reader("section table", reader.take("section table", sectionCount, ENTRY_BYTES));
    /** All sections in order: `{id, start, storedBytes, rawBytes}`. */
    this.entries = [];
    /** How many of them are there in full. */
    this.complete = 0;
    let start = reader.offset;
    for (let index = 0; index < sectionCount; index++) {
      const entry = readEntry(table, start);
      start = inRange(section, "end of sections", start + entry.storedBytes, 0, totalBytes);
      if (start <= bytes.length) this.complete++;
      this.entries.push(entry);
    }
    if (totalBytes > start) {
      const message = `${section}: ${totalBytes - start} bytes are left over at offset ${start}`;
      throw new ChunkError("trailing", message, { section });
    }
  }

  /** Where section `count − 1` ends: the length of the prefix that holds `count` sections. */
  endOf(count) {
    const last = this.entries[count - 1];
    return last.start + last.storedBytes;
  }

  /** Throws unless the table lists exactly the sections `wanted`, in that order. */
  checkSections(wanted) {
    inRange("header", "section count", this.entries.length, wanted.length, wanted.length);
    wanted.forEach(({ tag, part }, index) => {
      const { id } = this.entries[index];
      if (id.tag === tag && id.part.every((number, place) => number === part[place])) return;
      throw new ChunkError("section", `section ${tag} [${part.join(", ")}] is missing where it should be`);
    });
  }

  /** Throws if counts ask for more memory than the bytes that are there can answer for. */
  checkExpansion(decodedBytes) {
    inRange("header", "decoded bytes", decodedBytes, 0, EXPANSION_FREE_BYTES + EXPANSION_MAX * this.bytes.length);
  }

  /** Bytes that section `index` says its content has. */
  rawBytes(index) {
    return this.entries[index].rawBytes;
  }

  /** Unpacks section `index`, whose content may have up to `rawBytesMax` bytes. */
  section(index, name, rawBytesMax) {
    const { start, storedBytes, rawBytes } = this.entries[index];
    inRange(name, "raw length", rawBytes, 0, rawBytesMax);
    this.checkExpansion(rawBytes);
    const stored = new Reader(name, this.bytes.subarray(Math.min(start, this.bytes.length)));
    const frame = stored.take("section", storedBytes);
    try {
      return unpack(frame, rawBytes);
    } catch (cause) {
      if (!(cause instanceof ZstdError)) throw cause;
      const message = `${name}: does not decompress to ${rawBytes} bytes`;
      throw new ChunkError("compression", message, { section: name, cause });
    }
  }
}

/** Kind of a chunk, from its header. */
export function kindOf(bytes) {
  return readStart(new Reader("header", bytes));
}

function readStart(reader) {
  const magic = [...reader.take("magic", 4)];
  if (magic.some((byte, index) => byte !== MAGIC[index])) {
    const hex = magic.map((byte) => byte.toString(16).padStart(2, "0")).join(", ");
    throw new ChunkError("magic", `the bytes start with [${hex}], which is not a chunk`);
  }
  const version = reader.u16("version");
  if (version > VERSION || version === 0) {
    throw new ChunkError("version", `chunk version ${version} is not known; a newer kiln may read it`);
  }
  if (version < VERSION) {
    throw new ChunkError(
      "version",
      `the chunk is of version ${version}, and the browser reads version ${VERSION}: bake the scene again`,
    );
  }
  return reader.u8("kind");
}

function readFixed(wanted, reader) {
  const kind = readStart(reader);
  if (kind !== wanted) throw new ChunkError("kind", `the chunk is of kind ${kind}, wanted ${wanted}`);
  inRange("header", "reserved byte", reader.u8("reserved"), 0, 0);
  const headBytes = reader.u16("head length");
  const sectionCount = reader.u16("section count");
  inRange("header", "head length", headBytes, 0, HEAD_BYTES_MAX);
  inRange("header", "section count", sectionCount, 0, SECTIONS_MAX);
  return { headBytes, sectionCount };
}

function readEntry(reader, start) {
  const tag = reader.u8("tag");
  const part = [reader.u8("part"), reader.u8("part"), reader.u8("part")];
  const storedBytes = reader.u32("stored length");
  const rawBytes = reader.u32("raw length");
  return { id: sectionId(tag, part), start, storedBytes, rawBytes };
}
