// The passes of a bake's light on the device, with their buffers; twin of client/src/lightmap/passes.rs.

import { AtlasPass } from "./atlas.js";
import { ChangePass } from "./change.js";
import { DirectPass } from "./direct.js";
import { BasisPass, ReconstructPass } from "./factors.js";
import { NearPass } from "./near.js";
import { PatchesPass } from "./patches.js";
import { Resident } from "./resident.js";

/** direct → patches → basis → near → reconstruct → atlas. */
export class LightPasses {
  /** Uploads the light of a bake. */
  static async create(gpu, { scene, light }, shadow) {
    const passes = new LightPasses();
    Object.assign(passes, { gpu, light, made: [] });
    gpu.owned = passes.made;
    const resident = new Resident(gpu, light);
    passes.resident = resident;
    passes.direct = await DirectPass.create(gpu, light.points, shadow, resident);
    passes.columns = await PatchesPass.create(gpu, light.columns, resident);
    passes.basis = await BasisPass.create(gpu, light.clusters, resident);
    passes.near = await NearPass.create(gpu, light.near, shadow, resident);
    passes.reconstruct = await ReconstructPass.create(gpu, light.clusters, resident);
    passes.atlas = await AtlasPass.create(gpu, scene.layout, light.texels, resident);
    passes.change = await ChangePass.create(gpu, resident);
    gpu.owned = null;
    return passes;
  }

  /** Frees all buffers. */
  destroy() {
    this.made.forEach((thing) => thing.destroy());
  }

  /** Writes light that no shadow map has: E_emit, and λ of the sky. Answers whether any emitter sends light. */
  setUnshadowed(sky, emitterScale) {
    const { light, resident } = this;
    const emit = light.emitters.irradiance(light.receivers.count, emitterScale);
    this.gpu.write(resident.eEmit, emit);
    resident.writeSky(this.gpu, light.columns.skyLambda(sky));
    return emit.some((value) => value !== 0);
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
    this.near.record(pass);
    this.reconstruct.record(pass);
    pass.end();
  }

  /** Records E_emit + E_ind into the pages. */
  publish(encoder) {
    const pass = encoder.beginComputePass();
    this.atlas.record(pass);
    pass.end();
  }
}
