// Animations: places of nodes and weights of morph targets at a time (glTF 2.0 §3.11 and Appendix C); twin of
// worker/src/scene/animation.rs. A channel holds its first key before it and its last key after it.

import { fround } from "../relight/numbers.js";
import { Accessor } from "./accessor.js";
import { listOf, part } from "./document.js";
import { ObjectError, broken } from "./error.js";
import { LIMITS, within } from "./limits.js";

// Most values of a key: weights of morph targets.
const KEY_VALUES_MAX = 2 ** 12;
// Kind of accessor and numbers of an element by the path of a channel.
const PATHS = {
  __proto__: null,
  translation: { type: "VEC3", width: 3 },
  rotation: { type: "VEC4", width: 4 },
  scale: { type: "VEC3", width: 3 },
  weights: { type: "SCALAR", width: 1 },
};
const INTERPOLATIONS = ["LINEAR", "STEP", "CUBICSPLINE"];

/** Channels of an animation that say how a node stands; others are passed over, as the format asks. */
function channelsOf(document, clip) {
  const place = () => document.place("animation", clip);
  const channels = listOf(document.list("animation")[clip], "channels", place);
  return channels.map((channel) => ({ channel, target: part(channel, "target", place) })).filter(({ target }) => {
    return target !== null && target.path in PATHS && target.node !== undefined;
  });
}

/** Keys of the channels of an animation, each with its node. Errs on samplers, nodes or keys that are not there. */
export function openClip(document, budgets, clip) {
  return channelsOf(document, clip).map((named) => openChannel(document, budgets, clip, named));
}

function openChannel(document, budgets, clip, named) {
  const place = () => `a channel of ${document.place("animation", clip)}`;
  const keys = new Keys(document, budgets, clip, named, place);
  const node = document.get("node", named.target.node, place);
  if (keys.path !== "weights" && node.matrix !== undefined) {
    const problem = "it is animated, and has a matrix where a translation, rotation and scale are due";
    throw broken(document.place("node", named.target.node), problem);
  }
  return { node: named.target.node, path: keys.path, keys };
}

/** Length of each animation in seconds: the time of its last key. Channels that cannot be read count nothing. */
export function lengthsOf(document, budgets) {
  return document.list("animation").map((_, clip) => {
    const place = () => document.place("animation", clip);
    const lengthOf = (named) => {
      try {
        return new Keys(document, budgets, clip, named, place).lengthS;
      } catch (error) {
        if (error instanceof ObjectError) return 0;
        throw error;
      }
    };
    return channelsOf(document, clip).map(lengthOf).reduce((most, length) => (length > most ? length : most), 0);
  });
}

class Keys {
  constructor(document, budgets, clip, { channel, target }, place) {
    const samplers = listOf(document.list("animation")[clip], "samplers", place);
    const sampler = samplers[channel.sampler];
    if (typeof sampler !== "object" || sampler === null) throw broken(place(), "it names a sampler that is not there");
    this.path = target.path;
    this.interpolation = sampler.interpolation ?? "LINEAR";
    if (!INTERPOLATIONS.includes(this.interpolation)) throw broken(place(), "its interpolation is none of glTF's");
    const { type, width } = PATHS[this.path];
    this.elements = this.path === "weights" ? targetsOf(document, target.node) : 1;
    this.width = width;
    if (this.elements === 0 || this.elements > KEY_VALUES_MAX) {
      throw broken(place(), "its node has no mesh with morph targets, or too many");
    }
    const open = (index, kind, minCount) => {
      const wanted = { types: [kind], minCount, isNormalized: this.path === "rotation" };
      return new Accessor(document, budgets, index, wanted, place);
    };
    this.times = open(sampler.input, "SCALAR", 1);
    this.count = this.times.count;
    within(LIMITS.vertices, this.count);
    this.isSpline = this.interpolation === "CUBICSPLINE";
    this.values = open(sampler.output, type, this.count * this.elements * (this.isSpline ? 3 : 1));
  }

  get lengthS() {
    return this.#timeS(this.count - 1);
  }

  #timeS(key) {
    const time = [0];
    this.times.read(key, time, 0, 1);
    return time[0];
  }

  /** The value at a time, an f32. */
  at(timeS) {
    // Keys ascend by the format; of a file whose keys do not, some key is found.
    let [low, high] = [0, this.count];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.#timeS(middle) <= timeS) low = middle + 1;
      else high = middle;
    }
    if (low === 0) return this.#flat(0, 1);
    if (low === this.count || this.interpolation === "STEP") return this.#flat(low - 1, 1);
    const lengthS = fround(this.#timeS(low) - this.#timeS(low - 1));
    const share = lengthS > 0 ? fround(fround(timeS - this.#timeS(low - 1)) / lengthS) : 0;
    return this.isSpline ? this.#spline(low - 1, share, lengthS) : this.#linear(low - 1, share);
  }

  /** Numbers of a key; of a spline, `part` 0 is the tangent before it, 1 the value, 2 the tangent after it. */
  #flat(key, part) {
    const first = (this.isSpline ? 3 * key + part : key) * this.elements;
    const numbers = new Array(this.width * this.elements).fill(0);
    for (let element = 0; element < this.elements; element++) {
      this.values.read(first + element, numbers, this.width * element, this.width);
    }
    return numbers;
  }

  #linear(before, share) {
    const [a, b] = [this.#flat(before, 1), this.#flat(before + 1, 1)];
    if (this.path === "rotation") return slerp(unitOf(a), unitOf(b), share);
    return a.map((value, at) => fround(value + fround(fround(b[at] - value) * share)));
  }

  /** Appendix C.4: a Hermite spline, whose tangents are per second. Rotations are made unit by whoever places the node. */
  #spline(before, t, lengthS) {
    const t2 = fround(t * t);
    const t3 = fround(t2 * t);
    const weights = [
      fround(fround(2 * t3) - fround(3 * t2) + 1),
      fround(fround(fround(t3 - fround(2 * t2)) + t) * lengthS),
      fround(fround(3 * t2) - fround(2 * t3)),
      fround(fround(t3 - t2) * lengthS),
    ];
    const parts = [this.#flat(before, 1), this.#flat(before, 2), this.#flat(before + 1, 1), this.#flat(before + 1, 0)];
    const sum = (at) => parts.reduce((total, own, which) => fround(total + fround(own[at] * weights[which])), 0);
    return parts[0].map((_, at) => sum(at));
  }
}

function unitOf(quaternion) {
  const length = Math.sqrt(quaternion.reduce((sum, value) => sum + value * value, 0));
  return length > 0 ? quaternion.map((value) => value / length) : [0, 0, 0, 1];
}

/** The turn between two unit quaternions by the shorter way. */
function slerp(from, to, share) {
  const cos = from.reduce((sum, value, at) => sum + value * to[at], 0);
  const end = cos < 0 ? to.map((value) => -value) : to;
  const theta = Math.acos(Math.min(Math.abs(cos), 1));
  const isSame = Math.abs(cos) > 1 - Number.EPSILON;
  const [a, b] = isSame ? [1 - share, share] : [Math.sin(theta * (1 - share)), Math.sin(theta * share)];
  const mixed = from.map((value, at) => value * a + end[at] * b);
  return unitOf(mixed).map(fround);
}

/** Most morph targets of a primitive of a node's mesh. */
function targetsOf(document, node) {
  const mesh = document.list("mesh")[document.list("node")[node]?.mesh];
  const primitives = Array.isArray(mesh?.primitives) ? mesh.primitives : [];
  const counts = primitives.map((primitive) => (Array.isArray(primitive?.targets) ? primitive.targets.length : 0));
  return counts.reduce((most, count) => Math.max(most, count), 0);
}
