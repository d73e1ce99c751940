// Work that runs one piece after the other. Of pieces of a kind that wait the last alone counts, as of a slider's calls; pieces of other
// kinds are not lost by them.

export class Turns {
  // Waiting work by its kind, in the order of its last call.
  #waiting = new Map();
  #isBusy = false;
  #told;

  /** `told` hears of each piece's kind and how it ended: an error, or null. */
  constructor(told) {
    this.#told = told;
  }

  /** Runs work when its turn comes; ends when none waits. */
  async run(kind, work) {
    // A later call waits behind all others.
    this.#waiting.delete(kind);
    this.#waiting.set(kind, work);
    if (this.#isBusy) return;
    this.#isBusy = true;
    for (let next = this.#next(); next !== undefined; next = this.#next()) {
      const [own, piece] = next;
      try {
        await piece();
        this.#told(own, null);
      } catch (error) {
        this.#told(own, error);
      }
    }
    this.#isBusy = false;
  }

  #next() {
    const [first] = this.#waiting;
    if (first !== undefined) this.#waiting.delete(first[0]);
    return first;
  }
}
