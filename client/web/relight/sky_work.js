// Work on a panorama that needs neither network nor device. It runs in a Worker (`worker.js`), or where there is none on the page's own
// thread, by the same calls.

import { checkImage, reduced, texelsOf } from "./panorama_image.js";
import { decodeHdr } from "./radiance_hdr.js";
import { partMeans } from "./sky_parts.js";

export class SkyWork {
  // The light of the panorama in no more pixels than means need.
  #light;

  /** Takes the bytes of a Radiance HDR file; see `take`. */
  read(bytes) {
    return this.take(decodeHdr(bytes));
  }

  /** Takes `{width, height, pixels}`; its size, its pixels as a texture has them, the radiance of a texel of 1, the brightest number. */
  take(image) {
    const brightest = checkImage(image);
    const { width, height } = image;
    this.#light = reduced(image);
    return { width, height, brightest, ...texelsOf(image, brightest) };
  }

  /** See `partMeans`. */
  means(turnDeg, parts) {
    return partMeans(this.#light, turnDeg, parts);
  }
}
