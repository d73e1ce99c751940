// Radiance HDR files (.hdr) as pixels; accepts and refuses as client/src/lights/panorama.rs does.

import { PIXELS_MAX } from "./panorama_image.js";
import { fround, numberFrom, wholeFrom } from "./numbers.js";

// Beginnings of the files.
const SIGNATURES = ["#?RADIANCE", "#?RGBE"];
const FORMAT = "32-bit_rle_rgbe";
const [LINE_END, COMMENT] = [10, 35];
// Longest line of a header that is looked at.
const LINE_MAX = 2 ** 16;
const WORDS = new TextDecoder("utf-8", { ignoreBOM: true });

/** Bytes that are read one after the other; past the end is an error. */
class Reader {
  at = 0;

  constructor(bytes) {
    this.bytes = bytes;
  }

  byte() {
    if (this.at >= this.bytes.length) throw new Error("cannot be decoded: it ends within its pixels");
    return this.bytes[this.at++];
  }

  /** Bytes of the next line; null at the end. */
  line() {
    if (this.at >= this.bytes.length) return null;
    const found = this.bytes.indexOf(LINE_END, this.at);
    const end = found < 0 ? this.bytes.length : found;
    if (end - this.at > LINE_MAX) throw new Error("cannot be decoded: a line of its header is too long");
    const line = this.bytes.subarray(this.at, end);
    this.at = end + 1;
    return line;
  }
}

/**
 * Width, height and pixels of a file's bytes, three numbers each, the uppermost row first: radiance in W·m⁻²·sr⁻¹ once the header's
 * exposures are divided out. Errs where they are none, or too many.
 */
export function decodeHdr(bytes) {
  const isOf = (signature) => WORDS.decode(bytes.subarray(0, signature.length)) === signature;
  if (!SIGNATURES.some(isOf)) throw new Error("is no Radiance HDR file (.hdr); convert it to one");
  const reader = new Reader(bytes);
  const exposure = exposureOf(reader);
  const [width, height] = sizeOf(reader);
  if (width * height > PIXELS_MAX) {
    throw new Error(`has ${width} × ${height} pixels, more than the ${PIXELS_MAX} of a panorama: make it smaller`);
  }
  if (!(exposure > 0 && Number.isFinite(exposure))) throw new Error(`has an exposure of ${exposure}`);
  // Each row begins with four bytes: no file of a few bytes asks for much memory.
  if (width > 0 && bytes.length - reader.at < 4 * height) throw new Error("cannot be decoded: it ends within its pixels");
  const pixels = new Float32Array(3 * width * height);
  const row = new Uint8Array(4 * width);
  for (let y = 0; y < height && width > 0; y++) {
    readRow(reader, row, width);
    unpack(row, pixels.subarray(3 * width * y), exposure);
  }
  return { width, height, pixels };
}

/** Product of a header's exposures, 1 without any; leaves the reader behind the header. */
function exposureOf(reader) {
  let exposure = 1;
  for (;;) {
    const line = reader.line();
    if (line === null) throw new Error("cannot be decoded: it ends within its header");
    if (line.length === 0) return exposure;
    if (line[0] === COMMENT) continue;
    const text = WORDS.decode(line);
    const at = text.indexOf("=");
    if (at <= 0 || at + 1 === text.length) continue;
    const [key, value] = [text.slice(0, at).trim(), text.slice(at + 1).trim()];
    if (key === "FORMAT" && value !== FORMAT) throw new Error(`cannot be decoded: its format is '${value.slice(0, 20)}'`);
    if (key === "EXPOSURE") exposure = fround(exposure * (numberFrom(value) ?? 1));
  }
}

/** Width and height; rows from the top down alone are read. */
function sizeOf(reader) {
  const line = reader.line();
  const [down, height, across, width] = line === null ? [] : WORDS.decode(line).trim().split(/\s+/);
  if (down !== "-Y" || across !== "+X") throw new Error("cannot be decoded: its size is not written as '-Y height +X width'");
  const size = [width, height].map(wholeFrom);
  if (size.includes(null)) throw new Error("cannot be decoded: its size is no whole number");
  return size;
}

/** A row of pixels, four bytes each. */
function readRow(reader, row, width) {
  for (let channel = 0; channel < 4; channel++) row[channel] = reader.byte();
  if (row[0] === 2 && row[1] === 2 && row[2] < 128) {
    for (let channel = 0; channel < 4; channel++) readChannel(reader, row, channel, width);
  } else {
    readOldRow(reader, row, width);
  }
}

const tooLong = () => new Error("cannot be decoded: a row has more pixels than the picture is wide");

/** One channel of a row: runs of one value, or of several. */
function readChannel(reader, row, channel, width) {
  for (let x = 0; x < width; ) {
    const length = reader.byte();
    const isRun = length > 128;
    const end = x + (isRun ? length - 128 : length);
    if (end > width) throw tooLong();
    const value = isRun ? reader.byte() : 0;
    for (; x < end; x++) row[4 * x + channel] = isRun ? value : reader.byte();
  }
}

/** Pixels of a row whose first is there; one of 1,1,1 repeats the one before it. */
function readOldRow(reader, row, width) {
  const isMark = (at) => row[at] === 1 && row[at + 1] === 1 && row[at + 2] === 1;
  if (isMark(0)) throw new Error("cannot be decoded: a row begins with a repetition");
  for (let [x, scale] = [1, 1]; x < width; ) {
    for (let channel = 0; channel < 4; channel++) row[4 * x + channel] = reader.byte();
    if (!isMark(4 * x)) {
      [x, scale] = [x + 1, 1];
      continue;
    }
    const end = x + row[4 * x + 3] * scale;
    if (end > width) throw tooLong();
    for (; x < end; x++) row.copyWithin(4 * x, 4 * x - 4, 4 * x);
    scale *= 256;
  }
}

/** Bytes of a row → numbers. */
function unpack(row, pixels, exposure) {
  for (let x = 0; 4 * x < row.length; x++) {
    const exponent = row[4 * x + 3];
    const step = exponent === 0 ? 0 : 2 ** (exponent - 136);
    for (let channel = 0; channel < 3; channel++) {
      pixels[3 * x + channel] = fround(row[4 * x + channel] * step) / exposure;
    }
  }
}
