// Colours of materials other than those that a bake has: transport holds none, so none is traced again; twin of
// client/src/scene/recolour.rs.
//
//   const tints = new Tints(scene, [{ material: "wall", baseColour: [0.8, 0.1, 0.1] }]);
//   tints.albedo(scene, light.receivers), tints.baseColour(scene, material)

import { COLOUR, VERTEX_NUMBERS } from "./draws.js";
import { NO_BLOCK } from "./layout.js";
import { fround } from "./numbers.js";

/** Largest albedo, as in bakes: bounces in a whiter room would never end. */
export const ALBEDO_MAX = fround(0.98);
// Names of materials that an error lists.
const NAMES = 12;
// Base colour from which on the albedo of textures can be told from that of receivers, which has 8 bits.
const TINTED_MIN = fround(1e-3);
const CHANNELS = ["red", "green", "blue"];

/** Colours of a scene's materials, and the change of their albedo. */
export class Tints {
  // By material: `{baseColour, factor}`, the latter on the albedo of surfaces with textures or colours at vertices.
  #tints = new Map();

  /**
   * Other linear base colours, `{material, baseColour}`, each of all materials of that name; the last of a name counts. Errs for a name
   * that no material has, for glass, whose colour is that of what passes it, and where a material with textures is to reflect a channel
   * of which it has next to nothing.
   */
  constructor(scene, colours) {
    const { draws, manifest } = scene;
    const uneven = new Set(draws.filter((draw) => !isEven(scene, draw)).map(({ material }) => material));
    for (const { material: name, baseColour } of colours) {
      check(manifest.materials, name, baseColour);
      manifest.materials.forEach((material, index) => {
        if (material.name === name) this.#tints.set(index, tintOf(material, baseColour, uneven.has(index)));
      });
    }
  }

  /** Whether all is as baked. */
  get isEmpty() {
    return this.#tints.size === 0;
  }

  /** The colours as plain values, to be compared. */
  get plain() {
    return [...this.#tints].sort(([a], [b]) => a - b);
  }

  /** Base colour and alpha of a material. */
  baseColour({ manifest }, material) {
    const own = manifest.materials[material].baseColour;
    const tint = this.#tints.get(material);
    return tint === undefined ? own : [...tint.baseColour, own[3]];
  }

  /** Albedo of receivers by slot, four numbers each, under these colours. */
  albedo(scene, receivers) {
    const albedo = receivers.albedo.slice();
    const byBlock = this.#byBlock(scene);
    receivers.block.forEach((block, slot) => byBlock.get(block)?.(albedo, 4 * slot));
    return albedo;
  }

  /** Changes of the albedo from a place in an array on, by the block of the lightmap, by the mesh that reads it. */
  #byBlock(scene) {
    const byBlock = new Map();
    for (const draw of scene.draws) {
      const tint = this.#tints.get(draw.material);
      if (tint === undefined) continue;
      const change = isEven(scene, draw) ? becoming(tint.baseColour) : multiplied(tint.factor);
      [draw.front, draw.back].filter((block) => block !== NO_BLOCK).forEach((block) => byBlock.set(block, change));
    }
    return byBlock;
  }
}

function becoming(baseColour) {
  const albedo = baseColour.map((channel) => Math.min(channel, ALBEDO_MAX));
  return (all, at) => all.set(albedo, at);
}

function multiplied(factor) {
  return (all, at) => {
    for (let channel = 0; channel < 3; channel++) {
      all[at + channel] = Math.min(fround(all[at + channel] * factor[channel]), ALBEDO_MAX);
    }
  };
}

function tintOf({ name, baseColour: old }, baseColour, isUneven) {
  const made = Array.from(baseColour, fround);
  const lacking = made.findIndex((channel, at) => isUneven && old[at] < TINTED_MIN && channel > 0);
  if (lacking >= 0) {
    const rest = "so that of its textures is not known; give 0, or bake the scene with that colour";
    throw refused(name, `has next to no ${CHANNELS[lacking]} in the bake, ${rest}`);
  }
  const factor = made.map((channel, at) => (old[at] >= TINTED_MIN ? fround(channel / old[at]) : 1));
  return { baseColour: made, factor };
}

/** A mesh has one colour: neither a texture nor colours at vertices. */
function isEven({ manifest }, { material, vertices }) {
  if (manifest.materials[material].baseColourTexture) return false;
  for (let at = COLOUR; at < vertices.length; at += VERTEX_NUMBERS) {
    if (vertices[at] !== 1 || vertices[at + 1] !== 1 || vertices[at + 2] !== 1) return false;
  }
  return true;
}

function check(materials, name, baseColour) {
  const isColour = baseColour?.length === 3 && Array.from(baseColour).every((channel) => channel >= 0 && channel <= 1);
  if (!isColour) throw refused(name, "takes a linear colour with channels 0 to 1");
  const named = materials.filter((material) => material.name === name);
  if (named.length === 0) throw refused(name, `is none of the bake's: ${namesOf(materials)}`);
  if (named.some(({ glass }) => glass)) {
    throw refused(name, "is of glass: its colour is baked; bake the scene with another one");
  }
}

function refused(name, problem) {
  return new Error(`material '${name}': ${problem}`);
}

/** Names of a bake's materials, the first of many. */
function namesOf(materials) {
  const names = [...new Set(materials.map(({ name }) => name))].sort();
  const listed = `'${names.slice(0, NAMES).join("', '")}'`;
  return names.length > NAMES ? `${listed}, and ${names.length - NAMES} more` : listed;
}
