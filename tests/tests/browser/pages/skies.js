// Panoramas: files, means of the sky's parts, and refusals.

import { hexOf } from "/web/chunk/digest.js";
import { checkImage } from "/web/relight/panorama_image.js";
import { Panorama } from "/web/relight/panorama.js";
import { decodeHdr } from "/web/relight/radiance_hdr.js";

function bytesOf(hex) {
  return Uint8Array.from({ length: hex.length / 2 }, (_, at) => parseInt(hex.slice(2 * at, 2 * at + 2), 16));
}

/** Size and pixels of files, or the words with which each is refused. */
export async function read(files) {
  return files.map((file) => {
    try {
      const image = decodeHdr(bytesOf(file));
      checkImage(image);
      return { size: [image.width, image.height], pixels: hexOf(new Uint8Array(image.pixels.buffer)) };
    } catch (error) {
      return error.constructor === Error ? { error: error.message } : { thrown: String(error.stack) };
    }
  });
}

const opened = new Map();

async function panorama(name) {
  if (name === "file") return Panorama.read(name, new Uint8Array(await (await fetch("/sky.hdr")).arrayBuffer()));
  const pixels = new Float32Array(3 * 1500 * 750);
  for (let at = 0; at < pixels.length / 3; at++) pixels.set([at % 1500, Math.floor(at / 1500), 3], 3 * at);
  return Panorama.of(name, 1500, 750, pixels);
}

/** Means of parts of the sky by a Worker. */
export async function means(name, turnDeg, parts) {
  if (!opened.has(name)) opened.set(name, panorama(name));
  return [...(await (await opened.get(name)).means(turnDeg, parts))];
}

/** Words with which pixels, then turns and strengths, are refused. */
export async function refusals() {
  const told = ({ message }) => message;
  const made = (width, height, pixels) => Panorama.of("p", width, height, pixels).then(() => null, told);
  const good = await Panorama.of("p", 2, 1, [1, 2, 3, 4, 5, 6]);
  const checked = (...how) => {
    try {
      return good.check(...how);
    } catch (error) {
      return told(error);
    }
  };
  return [
    await made(0, 1, []),
    await made(2, 2, new Array(9).fill(0)),
    await made(2, 3, new Array(18).fill(0)),
    await made(2, 1, [0, 0, 0, 0, NaN, 0]),
    checked(NaN, 1),
    checked(0, -1),
    checked(0, 1e30),
  ];
}
