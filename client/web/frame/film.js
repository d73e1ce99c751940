// Samples of the picture as it is, and pictures that the device has not finished.

/** Samples per pixel of a picture that stands still. More → smoother edges, longer until it is done. */
export const SAMPLES_MAX = 16;
// Pictures under way from which on a device is behind.
const UNDER_WAY_MAX = 2;

export class Film {
  samples = 0;
  // What they were drawn with.
  #exposure = 1;
  #curve = "filmic";
  #isAlone = false;
  #underWay = 0;

  /** Begins anew. */
  clear() {
    this.samples = 0;
  }

  /** The number of the next sample; the first where it is to stand alone, and after others of another exposure or curve. */
  next(exposure, curve, isAlone) {
    if (isAlone || this.#isAlone || exposure !== this.#exposure || curve !== this.#curve) this.clear();
    [this.#exposure, this.#curve, this.#isAlone] = [exposure, curve, isAlone];
    return this.samples;
  }

  /** Counts a picture that was handed to a device. */
  handed(device) {
    this.#underWay += 1;
    const finished = () => (this.#underWay -= 1);
    device.queue.onSubmittedWorkDone().then(finished, finished);
  }

  get isBehind() {
    return this.#underWay >= UNDER_WAY_MAX;
  }
}

/** Offset of a sample from the pixel's middle: a rotated grid for the first four, then the R2 sequence. */
export function jitterOf(sample) {
  const grid = [[-0.125, -0.375], [0.375, -0.125], [-0.375, 0.125], [0.125, 0.375]];
  const at = (step) => ((0.5 + step * (sample + 1)) % 1) - 0.5;
  return grid[sample] ?? [at(0.7548776662466928), at(0.5698402909980533)];
}
