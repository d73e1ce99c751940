// Images of an object: kept as files, once it is sure that their pixels are within the limits; twin of worker/src/scene/images.rs.

import { bytesOfUri } from "./document.js";
import { ObjectError, broken } from "./error.js";
import { LIMITS, within } from "./limits.js";

const PNG = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];
const JPEG = [0xff, 0xd8, 0xff];
// Starts of images that glTF extensions and old exporters use, but that are not read: KTX, DDS, GIF, BMP, TIFF, RIFF (WebP).
const OTHERS = [[0xab, 0x4b, 0x54, 0x58], [0x44, 0x44, 0x53, 0x20], [0x47, 0x49, 0x46, 0x38], [0x42, 0x4d], [0x49, 0x49, 0x2a], [0x52, 0x49, 0x46, 0x46]];
// Markers of JPEG without a length, and those from 0xC0 to 0xCF that begin no frame.
const BARE = (marker) => marker === 0x01 || (marker >= 0xd0 && marker <= 0xd9);
const NO_FRAME = [0xc4, 0xc8, 0xcc];

/** An image of a document, `{mediaType, bytes, name}`; null, with a warning, where its format is none that is read. */
export function imageOf(document, budgets, index, warn) {
  const place = () => document.place("image", index);
  const bytes = bytesOf(document, index, place);
  const starts = (start) => start.every((value, at) => bytes[at] === value);
  // By the first bytes: stated media types are wrong too often.
  const mediaType = starts(PNG) ? "image/png" : starts(JPEG) ? "image/jpeg" : null;
  if (mediaType === null) {
    if (!OTHERS.some(starts)) throw unreadable(place);
    warn(`${place()} is neither PNG nor JPEG; the material's factor alone is used`);
    return null;
  }
  const size = mediaType === "image/png" ? pngSize(bytes) : jpegSize(bytes);
  if (size === null || size[0] * size[1] === 0) throw unreadable(place);
  within(LIMITS.texturePixels, size[0] * size[1]);
  budgets.spend(budgets.pixels, size[0] * size[1]);
  return { mediaType, bytes, name: place() };
}

function unreadable(place) {
  return new ObjectError(`${place()} is not a readable image; replace it with a PNG or JPEG`);
}

function bytesOf(document, index, place) {
  const { uri, bufferView } = document.list("image")[index];
  if (uri !== undefined) return bytesOfUri(uri, place);
  if (bufferView !== undefined) return document.view(bufferView, place);
  throw broken(place(), "it has neither a URI nor a buffer view");
}

function pngSize(bytes) {
  if (bytes.length < 24) return null;
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  return [view.getUint32(16), view.getUint32(20)];
}

/** Size by the header of the frame; null where there is none. */
function jpegSize(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 2;
  while (at + 9 <= bytes.length) {
    const marker = bytes[at + 1];
    if (bytes[at] !== 0xff) return null;
    if (marker === 0xff) at += 1;
    else if (BARE(marker)) at += 2;
    else if (marker >= 0xc0 && marker <= 0xcf && !NO_FRAME.includes(marker)) return [view.getUint16(at + 7), view.getUint16(at + 5)];
    else at += 2 + view.getUint16(at + 2);
  }
  return null;
}
