// Chunks that contradict the manifest or each other, or exceed a limit.

export class Inconsistent extends Error {
  constructor(place, problem) {
    super(`${place}: ${problem}`);
    this.name = "Inconsistent";
  }
}
