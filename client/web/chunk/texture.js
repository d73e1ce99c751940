// Textures (chunk kind 4): an image file as it was in the scene. A decoded one is `{mediaType, bytes: Uint8Array}`.

import { Container, sectionId } from "./container.js";
import { inRange } from "./error.js";
import { MEDIA_TYPE_BYTES_MAX, TEXTURE_BYTES_MAX } from "./limits.js";

/** Number of the kind in a chunk's header. */
export const TEXTURE = 4;

/** Decodes a texture chunk. The image itself is not looked at. */
export function decodeTexture(bytes) {
  const container = new Container(TEXTURE, bytes);
  const section = "texture head";
  inRange(section, "length of media type", container.head.length, 1, MEDIA_TYPE_BYTES_MAX);
  container.head.forEach((byte) => inRange(section, "character of media type", byte, 0x21, 0x7e));
  const mediaType = String.fromCharCode(...container.head);
  container.checkSections([sectionId(1)]);
  return { mediaType, bytes: container.section(0, "file", TEXTURE_BYTES_MAX) };
}
