// Lights and cameras as people write them, `kind key=value …`; twin of proto/src/words.

import { cross, less, normalised, times } from "./maths.js";
import { RECT_POINTS, RECT_POINTS_MAX, defaultUp, rectangleOf } from "./rectangle.js";

const POINT = "point pos=x,y,z color=r,g,b power=W";
const SPOT = "spot pos=x,y,z target=x,y,z (or dir=x,y,z) color=r,g,b power=W inner=degrees outer=degrees";
const SUN = "sun dir=x,y,z color=r,g,b irradiance=W/m2";
const RECT =
  "rect pos=x,y,z target=x,y,z (or dir=x,y,z) size=w,h color=r,g,b power=W (or radiance=W/m2/sr) up=x,y,z points=n";
const SKY = "sky zenith=r,g,b horizon=r,g,b strength=s";
const EMITTERS = "emitters scale=s";
const CAMERA = "eye=x,y,z target=x,y,z fov=degrees [up=x,y,z]";
const POSITION = ["pos", "position_m"];
const DIRECTION = ["dir", "direction"];
// Outer half angle of a spot, and vertical field of view, unless given.
const OUTER_DEG = 30;
const FOV_DEG = 50;

/** Words by their keys; each is taken once, and a word that is left over is an error. */
export class Words {
  #pairs = new Map();

  constructor(words, grammar) {
    this.grammar = grammar;
    for (const word of words) {
      const at = word.indexOf("=");
      const key = word.slice(0, at);
      if (at < 0) this.wrong(`'${word}' is not key=value`);
      if (this.#pairs.has(key)) this.wrong(`'${key}' is given twice`);
      this.#pairs.set(key, word.slice(at + 1));
    }
  }

  wrong(problem) {
    throw new Error(`${problem}; write "${this.grammar}"`);
  }

  /** The text of a word, if given. */
  text(key) {
    return this.#take([key])[1];
  }

  /** A number in a range, if given. */
  number(keys, lowest, highest) {
    const [key, text] = this.#take(keys);
    if (text === undefined) return undefined;
    const value = this.#finite(key, text);
    if (value < lowest || value > highest) this.wrong(`${key}=${value} is not in ${lowest}..=${highest}`);
    return value;
  }

  /** Whether a word is there. */
  has(key) {
    return this.#pairs.has(key);
  }

  /** Two numbers, if given. */
  pair(keys) {
    const [key, text] = this.#take(keys);
    if (text === undefined) return undefined;
    const parts = text.split(",").map((part) => this.#finite(key, part));
    if (parts.length !== 2) this.wrong(`'${key}=${text}' needs two numbers w,h`);
    return parts;
  }

  /** Three numbers, if given. */
  vector(keys) {
    const [key, text] = this.#take(keys);
    if (text === undefined) return undefined;
    const parts = text.split(",").map((part) => this.#finite(key, part));
    if (parts.length !== 3) this.wrong(`'${key}=${text}' needs three numbers x,y,z`);
    return parts;
  }

  /** A colour, if given: three numbers, none negative. */
  colour(key) {
    const colour = this.vector([key]);
    if (colour?.some((part) => part < 0)) this.wrong(`'${key}' has a negative part`);
    return colour;
  }

  /** A direction, normalised, if given. */
  direction(keys) {
    const vector = this.vector(keys);
    return vector && (normalised(vector) ?? this.wrong(`'${keys[0]}' has no length`));
  }

  required(key, value) {
    return value ?? this.wrong(`'${key}' is missing`);
  }

  /** Every word must have been taken. */
  end() {
    for (const key of this.#pairs.keys()) this.wrong(`unknown word '${key}'`);
  }

  #take(keys) {
    const key = keys.find((own) => this.#pairs.has(own));
    const text = this.#pairs.get(key);
    this.#pairs.delete(key);
    return [key, text];
  }

  #finite(key, text) {
    const number = text.trim() === "" ? NaN : Number(text);
    if (!Number.isFinite(number)) this.wrong(`'${text}' in '${key}' is not a number`);
    return number;
  }
}

const READERS = {
  point: [POINT, (words) => ({ kind: pointOf(words), strength: strengthOf(words, "power", 1 / (4 * Math.PI)) })],
  spot: [SPOT, (words) => ({ kind: spotOf(words), strength: strengthOf(words, "power", 1 / (4 * Math.PI)) })],
  sun: [SUN, (words) => ({ kind: sunOf(words), strength: strengthOf(words, "irradiance", 1) })],
  rect: [RECT, rectLight],
  sky: [SKY, skyLight],
};

/** Reads lights, each a text: `{lights, emitterScale}`, the latter undefined where no text says `emitters scale=s`. */
export function parseLights(texts) {
  const parsed = { lights: [], emitterScale: undefined };
  for (const text of texts) {
    const [name, ...rest] = text.trim().split(/\s+/);
    if (name === "emitters") {
      const words = new Words(rest, EMITTERS);
      parsed.emitterScale = words.required("scale", words.number(["scale"], 0, Infinity));
      words.end();
      continue;
    }
    const [grammar, read] = Object.hasOwn(READERS, name) ? READERS[name] : [];
    if (read === undefined) {
      const problem = `'${name.slice(0, 50)}' is no kind of light, which are point, spot, sun, rect, sky and emitters`;
      throw new Error(`${problem}; write "${POINT}"`);
    }
    const words = new Words(rest, grammar);
    parsed.lights.push({ name: text, ...read(words) });
    words.end();
  }
  return parsed;
}

/** Reads a camera. */
export function parseCamera(text) {
  const words = new Words(text.trim().split(/\s+/), CAMERA);
  const eyeM = words.required("eye", words.vector(["eye"]));
  const targetM = words.required("target", words.vector(["target"]));
  const fovDeg = words.number(["fov"], 1, 170) ?? FOV_DEG;
  const forward = normalised(less(targetM, eyeM)) ?? words.wrong("eye and target are the same point");
  // Straight up, or the view's top when it looks straight up or down.
  const up = words.direction(["up"]) ?? (Math.abs(forward[1]) > 0.999 ? [0, 0, -1] : [0, 1, 0]);
  if (Math.hypot(...cross(forward, up)) < 1e-4) words.wrong("up points along the view");
  words.end();
  return { name: "camera", eyeM, targetM, up, fovYRad: radians(fovDeg), orthographicHalfHeightM: null };
}

/** `strength`, or `color` times `key` times `unit`. */
function strengthOf(words, key, unit) {
  const strength = words.colour("strength");
  if (strength !== undefined) return strength;
  const colour = words.colour("color") ?? [1, 1, 1];
  return times(colour, words.required(key, words.number([key], 0, Infinity)) * unit);
}

function pointOf(words) {
  return { type: "point", positionM: words.required("pos", words.vector(POSITION)), rangeM: null };
}

function spotOf(words) {
  const { positionM } = pointOf(words);
  const direction = aimOf(words, positionM);
  const outerDeg = words.number(["outer", "outer_deg"], 0.1, 90) ?? OUTER_DEG;
  const innerDeg = words.number(["inner", "inner_deg"], 0, 90) ?? 0.8 * outerDeg;
  if (innerDeg > outerDeg) words.wrong(`inner=${innerDeg} is wider than outer=${outerDeg}`);
  return { type: "spot", positionM, direction, innerRad: radians(innerDeg), outerRad: radians(outerDeg), rangeM: null };
}

/** Direction of travel: `dir`, or from the position to `target`. */
function aimOf(words, positionM) {
  const along = words.direction(DIRECTION);
  const target = words.vector(["target"]);
  if (along && target) words.wrong("give 'dir' or 'target', not both");
  if (!along && !target) words.wrong("'target' (or 'dir') is missing");
  return along ?? normalised(less(target, positionM)) ?? words.wrong("pos and target are the same point");
}

function rectLight(words) {
  const { positionM } = pointOf(words);
  const direction = aimOf(words, positionM);
  const up = words.direction(["up"]) ?? defaultUp(direction);
  const sizeM = words.required("size", words.pair(["size", "size_m"]));
  const points = words.number(["points"], 1, RECT_POINTS_MAX) ?? RECT_POINTS;
  if (!Number.isInteger(points)) words.wrong(`points=${points} is no whole number`);
  const kind = { type: "rect", positionM, direction, up, sizeM, points };
  if (rectangleOf(kind) === null) words.wrong(`size=${sizeM} has no area`);
  const isPower = words.has("power");
  const unit = isPower ? 1 / (Math.PI * sizeM[0] * sizeM[1]) : 1;
  return { kind, strength: strengthOf(words, isPower ? "power" : "radiance", unit) };
}

function sunOf(words) {
  return { type: "sun", direction: words.required("dir", words.direction(DIRECTION)) };
}

function skyLight(words) {
  const [zenith, horizon] = ["zenith", "horizon"].map((key) => words.colour(key) ?? [1, 1, 1]);
  const strength = words.number(["strength"], 0, Infinity) ?? 1;
  return { kind: { type: "sky", zenith, horizon }, strength: [strength, strength, strength] };
}

function radians(degrees) {
  return (degrees * Math.PI) / 180;
}
