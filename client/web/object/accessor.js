// Reading accessors: strided, sparse, normalised and quantised, with every range checked once on opening; twin of
// worker/src/scene/accessor.rs.

import { fround } from "../relight/numbers.js";
import { part, slice, whole } from "./document.js";
import { broken } from "./error.js";
import { LIMITS, within } from "./limits.js";

// Component types by glTF's numbers: size in bytes, reading, and the largest value where they are fractions.
const COMPONENTS = {
  __proto__: null,
  5120: { bytes: 1, read: (view, at) => view.getInt8(at), most: 127 },
  5121: { bytes: 1, read: (view, at) => view.getUint8(at), most: 255, isUnsigned: true },
  5122: { bytes: 2, read: (view, at) => view.getInt16(at, true), most: 32767 },
  5123: { bytes: 2, read: (view, at) => view.getUint16(at, true), most: 65535, isUnsigned: true },
  5125: { bytes: 4, read: (view, at) => view.getUint32(at, true), most: 2 ** 32 - 1, isUnsigned: true },
  5126: { bytes: 4, read: (view, at) => view.getFloat32(at, true), most: null },
};
const WIDTHS = { __proto__: null, SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT2: 4, MAT3: 9, MAT4: 16 };

/** An accessor whose every element is known to lie inside its buffers. */
export class Accessor {
  // Bytes from the first element on; null when all elements are zero but for the sparse ones.
  #dense = null;
  // Elements that replace dense ones: indices in rising order, and their packed values.
  #sparse = null;

  /**
   * Opens an accessor of a document. `wanted` has the types that fit, the least count, and whether integers are fractions even where
   * the file does not say so; `place` is a function that says who reads it.
   */
  constructor(document, budgets, index, { types, minCount = 0, isNormalized = false }, place) {
    const stated = document.get("accessor", index, place);
    const own = () => `${place()} (accessor ${index})`;
    this.component = COMPONENTS[stated.componentType];
    this.width = WIDTHS[stated.type];
    if (this.component === undefined || this.width === undefined) throw broken(own(), "its type is not one of glTF's");
    if (!types.includes(stated.type)) throw broken(own(), `it has elements of type ${stated.type}, which do not fit here`);
    this.count = whole(stated, "count", own);
    if (this.count < minCount) throw broken(own(), `it has ${this.count} elements where ${minCount} are needed`);
    this.isNormalized = isNormalized || stated.normalized === true;
    this.bytes = this.component.bytes * this.width;
    this.stride = this.bytes;
    this.#openDense(document, stated, own);
    const sparse = part(stated, "sparse", own);
    if (sparse !== null) this.#openSparse(document, budgets, sparse, own);
  }

  #openDense(document, stated, place) {
    if (stated.bufferView === undefined) {
      within(LIMITS.zeroElements, this.count);
      return;
    }
    const bytes = document.view(stated.bufferView, place);
    // Some exporters write a stride of 0 where they mean "packed".
    const stride = whole(document.list("buffer view")[stated.bufferView], "byteStride", place, 0);
    if (stride !== 0) this.stride = stride;
    const offset = whole(stated, "byteOffset", place, 0);
    const span = this.count === 0 ? 0 : (this.count - 1) * this.stride + this.bytes;
    const found = slice(bytes, offset, span);
    if (found === null) {
      const problem = `its ${this.count} elements from byte ${offset} do not fit into its view of ${bytes.length} bytes`;
      throw broken(place(), problem);
    }
    this.#dense = viewOf(found);
  }

  #openSparse(document, budgets, stated, place) {
    const count = whole(stated, "count", place);
    budgets.spend(LIMITS.sparseElements, count);
    const read = (name, bytesOf) => {
      const own = part(stated, name, place) ?? {};
      const each = bytesOf(own);
      const view = document.view(own.bufferView, place);
      const found = slice(view, whole(own, "byteOffset", place, 0), count * each);
      if (found === null) throw broken(place(), "its sparse elements do not fit into their view");
      return viewOf(found);
    };
    let index = null;
    const places = read("indices", ({ componentType }) => {
      index = COMPONENTS[componentType];
      if (!index?.isUnsigned) throw broken(place(), "its sparse indices are not unsigned integers");
      return index.bytes;
    });
    const indices = Uint32Array.from({ length: count }, (_, slot) => index.read(places, slot * index.bytes));
    const isRising = indices.every((value, slot) => slot === 0 || indices[slot - 1] < value);
    if (!isRising || (count > 0 && indices[count - 1] >= this.count)) {
      throw broken(place(), "its sparse indices do not rise within range");
    }
    this.#sparse = { slots: new Map(Array.from(indices, (value, slot) => [value, slot])), values: read("values", () => this.bytes) };
  }

  /** Whether elements are unsigned integers. */
  get isUnsigned() {
    return this.component.isUnsigned === true;
  }

  /** Writes the first `width` components of an element to `out` from a place on; those that it lacks are `missing`. */
  read(element, out, at, width, missing = 0) {
    const slot = this.#sparse?.slots.get(element);
    const view = slot === undefined ? this.#dense : this.#sparse.values;
    const start = slot === undefined ? element * this.stride : slot * this.bytes;
    for (let axis = 0; axis < width; axis++) {
      if (axis >= this.width) out[at + axis] = missing;
      else out[at + axis] = view === null ? 0 : this.#component(view, start + axis * this.component.bytes);
    }
  }

  #component(view, at) {
    const { read, most } = this.component;
    const value = read(view, at);
    return fround(this.isNormalized && most !== null ? Math.max(value / most, -1) : value);
  }

  /** The first component of an element, which is an unsigned integer. */
  unsigned(element) {
    const slot = this.#sparse?.slots.get(element);
    if (slot !== undefined) return this.component.read(this.#sparse.values, slot * this.bytes);
    return this.#dense === null ? 0 : this.component.read(this.#dense, element * this.stride);
  }
}

function viewOf({ buffer, byteOffset, byteLength }) {
  return new DataView(buffer, byteOffset, byteLength);
}
