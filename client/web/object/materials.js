// Materials of an object as manifests state them: base colour, emission, mask, glass, normal map, specular reflection and sides; twin of
// worker/src/scene/materials.rs, worker/src/scene/details.rs and worker/src/assemble/materials.rs.

import { fround } from "../relight/numbers.js";
import { number, numbers, part } from "./document.js";
import { LimitError, ObjectError } from "./error.js";
import { imageOf } from "./image.js";

// Cutoff of masks whose own is no number: glTF's default.
const CUTOFF = 0.5;
// Highest emission, in W·m⁻²·sr⁻¹.
const EMISSION_MAX = 1e12;
// Largest factor on a normal map's x and y.
const SCALE_MAX = 1e3;
const WRAPS = { __proto__: null, 33071: "clamp", 33648: "mirror" };
const IDENTITY = [[1, 0, 0], [0, 1, 0]];

/** A material without texture or light; parts of it are given. */
export function plainMaterial(parts = {}) {
  return {
    name: "material",
    baseColour: [1, 1, 1, 1],
    baseColourTexture: null,
    emissive: [0, 0, 0],
    emissiveTexture: null,
    emitter: null,
    alphaCutoff: null,
    glass: null,
    normalMap: null,
    specular: null,
    doubleSided: false,
    ...parts,
  };
}

/** Materials of a document, with the images that they use. */
export class MaterialTable {
  // Number of an image among those that are used, null where it is none, by its index and what of it is read.
  #slots = new Map();
  #default = null;

  constructor(document, budgets, warn) {
    Object.assign(this, { document, budgets, warn, images: [] });
    // As read, with textures each under their own transform.
    const all = document.list("material");
    this.read = all.map((stated, index) => this.#material(stated, index));
    // Behind all colours, whose images come first.
    all.forEach((stated, index) => this.#details(this.read[index], stated, index));
  }

  /** Index of the material that a primitive names, or of glTF's default one. */
  indexOf(named, place) {
    if (named !== undefined) {
      this.document.get("material", named, place);
      return named;
    }
    this.#default ??= this.read.push(plainMaterial({ name: "default" })) - 1;
    return this.#default;
  }

  /** Materials as manifests state them. */
  get materials() {
    return this.read.map((material) => {
      const beside = (used) => besideBase(material, used);
      const { glass, normalMap, specular, baseColourTexture: base } = material;
      const normals = normalMap && beside(normalMap.texture);
      return {
        ...material,
        baseColourTexture: base && useOf(base, null),
        emissiveTexture: beside(material.emissiveTexture),
        glass: glass && { ...glass, transmissionTexture: beside(glass.transmissionTexture) },
        normalMap: normals && { ...normalMap, texture: normals },
        specular: specular && { ...specular, texture: beside(specular.texture) },
      };
    });
  }

  /** The UV set that a mesh of a material is drawn with, and the transform that is folded into it. */
  uvsOf(index) {
    const first = firstTexture(this.read[index]);
    return { set: first?.uvSet ?? null, transform: this.read[index].baseColourTexture?.transform ?? null };
  }

  #material(stated, index) {
    const place = () => this.document.place("material", index);
    const extensions = part(stated, "extensions", place) ?? {};
    const pbr = part(stated, "pbrMetallicRoughness", place) ?? {};
    const old = part(extensions, "KHR_materials_pbrSpecularGlossiness", place);
    const [factor, texture] = old === null ? ["baseColorFactor", "baseColorTexture"] : ["diffuseFactor", "diffuseTexture"];
    const strength = number(part(extensions, "KHR_materials_emissive_strength", place), "emissiveStrength", place, 1);
    const emissive = numbers(stated, "emissiveFactor", 3, place, [0, 0, 0]).map((channel) => fround(channel * strength));
    const brightest = emissive.reduce((most, channel) => Math.max(most, channel), 0);
    if (brightest > EMISSION_MAX) {
      const most = `(at most ${EMISSION_MAX})`;
      throw new ObjectError(`${place()} emits ${brightest} W·m⁻²·sr⁻¹ ${most}; set a strength that is meant`);
    }
    return {
      name: typeof stated.name === "string" ? stated.name : `material ${index}`,
      baseColour: numbers(old ?? pbr, factor, 4, place, [1, 1, 1, 1]).map((channel) => usable(channel, 1)),
      baseColourTexture: this.#texture(part(old ?? pbr, texture, place), "colour", place),
      emissive: emissive.map((channel) => usable(channel, EMISSION_MAX)),
      emissiveTexture: this.#texture(part(stated, "emissiveTexture", place), "colour", place),
      emitter: null,
      alphaCutoff: cutoffOf(stated, place),
      glass: this.#glass(stated, pbr, extensions, place),
      doubleSided: stated.doubleSided === true,
    };
  }

  /** Glass by alphaMode BLEND or by transmission; null where all light is stopped, or met by a mask. */
  #glass(stated, pbr, extensions, place) {
    const blends = stated.alphaMode === "BLEND";
    const extension = part(extensions, "KHR_materials_transmission", place);
    // Through metal nothing passes; where a texture tells of metal, files have no transmission.
    const metal = pbr.metallicRoughnessTexture === undefined ? usable(number(pbr, "metallicFactor", place, 1), 1) : 0;
    const transmission = fround(usable(number(extension, "transmissionFactor", place, 0), 1) * fround(1 - metal));
    const texture = transmission > 0 ? part(extension, "transmissionTexture", place) : null;
    const transmissionTexture = this.#texture(texture, "red", place);
    return blends || transmission > 0 ? { blends, transmission, transmissionTexture } : null;
  }

  /** Normal map, and reflection by metallic and roughness: what pictures alone show. */
  #details(material, stated, index) {
    const place = () => this.document.place("material", index);
    const normals = part(stated, "normalTexture", place);
    const texture = normals && this.#numbersOf(material, normals, place);
    if (texture) {
      const scale = number(normals, "scale", place, 1);
      const isScale = Math.abs(scale) <= SCALE_MAX;
      if (!isScale) this.warn(`${place()} scales its normal map by more than ${SCALE_MAX}; 1 is taken`);
      material.normalMap = { texture, scale: isScale ? scale : 1 };
    }
    material.specular = this.#specular(material, stated, place);
  }

  /** Null where a surface reflects as a diffuse one does: fully rough without a texture; and of glass and of the old kind. */
  #specular(material, stated, place) {
    const pbr = part(stated, "pbrMetallicRoughness", place) ?? {};
    const isOld = part(part(stated, "extensions", place) ?? {}, "KHR_materials_pbrSpecularGlossiness", place) !== null;
    const [metallic, roughness] = ["metallicFactor", "roughnessFactor"].map((factor) => number(pbr, factor, place, 1));
    const named = part(pbr, "metallicRoughnessTexture", place);
    if (isOld || material.glass !== null || (named === null && roughness >= 1)) return null;
    const texture = named && this.#numbersOf(material, named, place);
    const specular = { metallic: usable(metallic, 1), roughness: usable(roughness, 1), texture };
    return texture !== null || specular.roughness < 1 ? specular : null;
  }

  /** A texture of linear numbers on the UV set that meshes of the material are drawn with; null, with a warning, on another. */
  #numbersOf(material, info, place) {
    const texture = this.#texture(info, "numbers", place);
    const drawn = firstTexture(material);
    if (texture === null || drawn === null || drawn.uvSet === texture.uvSet) return texture;
    this.warn(`${place()} has a normal map or a metallic-roughness texture on another UV set than its colour; it is left out`);
    return null;
  }

  /** A texture and how it is read; null, with a warning, where its factor alone is used. */
  #texture(info, channel, place) {
    if (info === null) return null;
    const { document } = this;
    const texture = document.get("texture", info.index, place);
    const transform = part(part(info, "extensions", place), "KHR_texture_transform", place);
    const uvSet = transform?.texCoord ?? info.texCoord ?? 0;
    if (uvSet !== 0 && uvSet !== 1) {
      this.warn(`${place()} has a texture on UV set ${uvSet}; only 0 and 1 are read, its factor alone is used`);
      return null;
    }
    if (texture.source === undefined) {
      this.warn(`${place()} has a texture without a PNG or JPEG; its factor alone is used`);
      return null;
    }
    document.get("image", texture.source, place);
    const slot = this.#slot(texture.source, channel);
    if (slot === null) return null;
    const sampler = texture.sampler === undefined ? {} : document.get("sampler", texture.sampler, place);
    const wrap = [sampler.wrapS, sampler.wrapT].map((mode) => WRAPS[mode] ?? "repeat");
    return { texture: slot, uvSet, wrap, transform: this.#rows(transform, place) };
  }

  #slot(index, channel) {
    const key = `${index} ${channel}`;
    if (!this.#slots.has(key)) {
      const image = channel === "numbers" ? this.#detailImage(index) : imageOf(this.document, this.budgets, index, this.warn);
      this.#slots.set(key, image && this.images.push({ ...image, channel }) - 1);
    }
    return this.#slots.get(key);
  }

  /** An image for pictures alone; null, with a warning, where there is no room for its pixels. */
  #detailImage(index) {
    try {
      return imageOf(this.document, this.budgets, index, this.warn);
    } catch (error) {
      if (!(error instanceof LimitError)) throw error;
      this.warn(`a normal map or a metallic-roughness texture is left out: ${error.message}`);
      return null;
    }
  }

  /** KHR_texture_transform as a 2×3 map: `uv' = T · R · S · uv`, turned counter-clockwise as seen with v downwards. */
  #rows(transform, place) {
    if (transform === null) return IDENTITY;
    const angle = number(transform, "rotation", place, 0);
    const [sin, cos] = [Math.sin(angle), Math.cos(angle)];
    const [scaleU, scaleV] = numbers(transform, "scale", 2, place, [1, 1]);
    const [offsetU, offsetV] = numbers(transform, "offset", 2, place, [0, 0]);
    const rows = [[cos * scaleU, sin * scaleV, offsetU], [-sin * scaleU, cos * scaleV, offsetV]].map((row) => row.map(fround));
    if (rows.flat().every(Number.isFinite)) return rows;
    this.warn(`${place()} has a texture transform that is not finite, and is read without`);
    return IDENTITY;
  }
}

/** A factor within its range; what is no number becomes 0. */
function usable(value, most) {
  return value > 0 ? Math.min(value, most) : 0;
}

function cutoffOf(stated, place) {
  if (stated.alphaMode !== "MASK") return null;
  const cutoff = number(stated, "alphaCutoff", place, CUTOFF);
  return Number.isFinite(cutoff) ? Math.max(cutoff, 0) : CUTOFF;
}

/** The texture whose UV set a mesh is drawn with; null without one. */
function firstTexture({ baseColourTexture, emissiveTexture, glass, normalMap, specular }) {
  const ofColours = baseColourTexture ?? emissiveTexture ?? glass?.transmissionTexture;
  return ofColours ?? normalMap?.texture ?? specular?.texture ?? null;
}

/** A texture relative to a mesh's UV, which has the base colour's transform folded in; null where its UV set is another. */
function besideBase(material, used) {
  if (!used || firstTexture(material).uvSet !== used.uvSet) return null;
  const base = material.baseColourTexture;
  const relative = base === null ? used.transform : afterInverse(used.transform, base.transform);
  return relative && useOf(used, isSame(relative, IDENTITY) ? null : relative);
}

function useOf({ texture, wrap }, transform) {
  return { texture, wrap, transform };
}

function isSame(a, b) {
  return a.flat().every((value, at) => value === b.flat()[at]);
}

/** `outer ∘ base⁻¹` of maps of two rows; null where `base` has no inverse. */
function afterInverse(outer, base) {
  if (isSame(outer, base)) return IDENTITY;
  const [[a, b, c], [d, e, f]] = base;
  const determinant = a * e - b * d;
  if (determinant === 0) return null;
  const inverse = [[e, -b, b * f - c * e], [-d, a, c * d - a * f]].map((row) => row.map((value) => value / determinant));
  return outer.map(([x, y, z]) => [0, 1, 2].map((i) => fround(x * inverse[0][i] + y * inverse[1][i] + (i === 2 ? z : 0))));
}
