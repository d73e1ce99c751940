// A panorama as a sky: a picture of all directions, in linear radiance.
//
//   const panorama = await Panorama.read(file.name, new Uint8Array(await file.arrayBuffer()));
//   await frame.setSky(panorama, { turnDeg: 90, strength: 2 });
//   panorama.close();

import { RADIANCE_MAX } from "./panorama_image.js";
import { openSkyWork } from "./workers.js";

export class Panorama {
  #work;
  // The means that were asked for last, with what they are of.
  #means = { key: null, found: null };

  /**
   * Reads the bytes of a Radiance HDR file (.hdr), whose memory it takes; `name` is for messages. Errs where it is none, is too large, or
   * holds numbers that are no radiance. A Worker lives until `close`.
   */
  static read(name, bytes) {
    return Panorama.#open(name, "readSky", [bytes], [bytes.buffer]);
  }

  /** Takes pixels of equirectangular projection, three numbers of radiance each in a Float32Array, the uppermost row first. */
  static of(name, width, height, pixels) {
    return Panorama.#open(name, "takeSky", [{ width, height, pixels: Float32Array.from(pixels) }], []);
  }

  static async #open(name, call, args, memory) {
    const panorama = new Panorama();
    panorama.name = name;
    panorama.#work = await openSkyWork();
    try {
      Object.assign(panorama, await panorama.#work.call(call, args, memory));
    } catch (error) {
      panorama.close();
      throw new Error(`panorama ${name}: ${error.message}`);
    }
    return panorama;
  }

  /** Mean radiance of the parts of a bake's sky, before a strength, see `partMeans`. */
  means(turnDeg, parts) {
    const key = `${turnDeg} ${parts}`;
    if (this.#means.key !== key) {
      const found = this.#work.call("skyMeans", [turnDeg, parts]);
      this.#means = { key, found };
      // A failure is not kept.
      found.catch(() => (this.#means = { key: null, found: null }));
    }
    return this.#means.found;
  }

  /** Errs for a turn and a strength that are none, and where pixels are bright beyond all measure by it. */
  check(turnDeg, strength) {
    if (!(Number.isFinite(turnDeg) && Number.isFinite(strength) && strength >= 0)) {
      throw new Error(`panorama ${this.name}: turn=${turnDeg} strength=${strength} is not finite, or the strength is negative`);
    }
    if (strength * this.brightest > RADIANCE_MAX) {
      const problem = `strength=${strength} makes its brightest pixel, of ${this.brightest}, brighter than 1e30`;
      throw new Error(`panorama ${this.name}: ${problem}: give a lower one`);
    }
  }

  /** Ends its Worker: frames that have it keep it, but take no other turn. */
  close() {
    this.#work.close();
  }
}
