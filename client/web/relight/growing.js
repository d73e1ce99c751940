// Typed arrays whose length is known only at the end.

export class Growing {
  #array;

  /** An empty array of a typed array's kind. */
  constructor(Kind) {
    this.#array = new Kind(1024);
    this.length = 0;
  }

  push(value) {
    this.reserve(1);
    this.#array[this.length++] = value;
  }

  /** Appends the values of an array. */
  extend(values) {
    this.reserve(values.length);
    this.#array.set(values, this.length);
    this.length += values.length;
  }

  get(index) {
    return this.#array[index];
  }

  /** The values, and no more. */
  finish() {
    return this.#array.slice(0, this.length);
  }

  reserve(count) {
    if (this.length + count <= this.#array.length) {
      return;
    }
    const longer = new this.#array.constructor(Math.max(2 * this.#array.length, this.length + count));
    longer.set(this.#array);
    this.#array = longer;
  }
}
