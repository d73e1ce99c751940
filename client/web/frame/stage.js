// What a frame draws, the bake's meshes and those of objects, with all that is made for them: adding or removing an object makes another
// stage.

import { heard } from "./device.js";
import { ShadePass } from "./shade.js";

export class Stage {
  /**
   * Makes the stage of a set of objects. `meshes` are the bake's own, `sky` is a panorama with its turn and strength, or null. Frees all
   * of it where that fails.
   */
  static async create(whole, set, { meshes, shadow, atlas, size, sky }) {
    const stage = new Stage();
    Object.assign(stage, { shadow, gpu: whole.branch(), casters: null, shade: null });
    try {
      await heard(whole.device, async () => {
        const all = await meshes.and(stage.gpu, set.scene);
        stage.casters = shadow.castersOf(stage.gpu, set.scene, all);
        stage.shade = await ShadePass.create(whole, set.scene, all, shadow, atlas, size);
        if (sky !== null) await stage.shade.setPanorama(sky.panorama, sky.turnDeg, sky.strength);
      });
    } catch (error) {
      if (stage.casters !== null) shadow.drop(stage.casters);
      stage.destroy();
      throw error;
    }
    return stage;
  }

  /** Frees what is the stage's own. */
  destroy() {
    this.shade?.destroy();
    this.gpu.destroy();
  }
}
