// The passes of a bake's light on the device, with their buffers; twin of client/src/lightmap/passes.rs.

import { AtlasPass } from "./atlas.js";
import { ChangePass } from "./change.js";
import { heard } from "./device.js";
import { DirectPass } from "./direct.js";
import { BasisPass, ReconstructPass } from "./factors.js";
import { LodPass } from "./lod.js";
import { NearPass } from "./near.js";
import { PatchesPass } from "./patches.js";
import { Resident } from "./resident.js";

/** direct → patches → basis → near → reconstruct → stand-ins of the level of detail → atlas. */
export class LightPasses {
  /** Null until `makeLod`. */
  lod = null;

  /** Uploads the light of a bake. Frees all of it where that fails. */
  static async create(whole, bake, shadow) {
    const passes = new LightPasses();
    passes.gpu = whole.branch();
    try {
      await passes.#make(bake, shadow);
    } catch (error) {
      passes.destroy();
      throw error;
    }
    return passes;
  }

  /** The same, also with what levels of detail need, once the device has refused nothing. Frees all of it where that fails. */
  static async heard(gpu, bake, shadow, hasLod) {
    let passes = null;
    try {
      await heard(gpu.device, async () => {
        passes = await LightPasses.create(gpu, bake, shadow);
        if (hasLod) await passes.makeLod();
      });
    } catch (error) {
      passes?.destroy();
      throw error;
    }
    return passes;
  }

  async #make({ scene, light }, shadow) {
    const { gpu } = this;
    const resident = new Resident(gpu, light);
    // Devices compile pipelines at once.
    const made = [
      DirectPass.create(gpu, light.points, shadow, resident),
      PatchesPass.create(gpu, light.columns, resident),
      BasisPass.create(gpu, light.clusters, resident),
      NearPass.create(gpu, light.near, shadow, resident),
      ReconstructPass.create(gpu, light.clusters, resident),
      AtlasPass.create(gpu, scene.layout, light.texels, resident),
      ChangePass.create(gpu, resident),
    ];
    // After an error, none of the others makes a buffer that nobody frees.
    await Promise.allSettled(made);
    const [direct, columns, basis, near, reconstruct, atlas, change] = await Promise.all(made);
    Object.assign(this, { light, resident, direct, columns, basis, near, reconstruct, atlas, change });
  }

  /** Frees all buffers. */
  destroy() {
    this.lod?.destroy();
    this.gpu.destroy();
  }

  /**
   * Writes light that no shadow map has: E_emit, and λ of the sky, to which `means` of its parts are added by a strength, `{means, strength}`
   * or null. Answers whether any emitter sends light.
   */
  setUnshadowed(sky, panorama, emitterScale) {
    const { light, resident } = this;
    const emit = light.emitters.irradiance(light.receivers.count, emitterScale);
    this.gpu.write(resident.eEmit, emit);
    const lambda = light.columns.skyLambda(sky);
    panorama?.means.forEach((mean, at) => (lambda[at] += panorama.strength * mean));
    resident.writeSky(this.gpu, lambda);
    return emit.some((value) => value !== 0);
  }

  /** Writes albedo of receivers by slot; `relit` is to follow, as light of near hits has it too. */
  setAlbedo(albedo) {
    this.gpu.write(this.resident.albedo, albedo);
  }

  /** Records E_dir at receivers and near hits, from new shadow maps. */
  relit(encoder) {
    const pass = encoder.beginComputePass();
    this.direct.record(pass);
    this.near.light(pass);
    pass.end();
  }

  /** Records one bounce: E_ind of the one before → E_ind. */
  bounce(encoder) {
    const pass = encoder.beginComputePass();
    this.columns.record(pass);
    this.basis.record(pass);
    this.lod?.mark(pass);
    this.near.record(pass);
    this.reconstruct.record(pass);
    this.lod?.fill(pass);
    pass.end();
  }

  /** Makes what levels of detail need, once. */
  async makeLod() {
    this.lod ??= await LodPass.create(this.gpu, this.light.lod, this.resident);
  }

  /** Records E_emit + E_ind into the pages. */
  publish(encoder) {
    const pass = encoder.beginComputePass();
    this.atlas.record(pass);
    pass.end();
  }
}
