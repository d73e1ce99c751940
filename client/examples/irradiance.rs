//! Reads indirect irradiance near a point under the bake's own lights, for a program that shades by itself:
//! `cargo run --release -p lightkiln-client --example irradiance -- room.kiln 0 1 0`.

use std::error::Error;

use glam::Vec3;
use lightkiln_client::bake::{LitScene, Unshadowed};
use lightkiln_client::fetch::Source;
use lightkiln_client::kinds::prt;
use lightkiln_client::lights::{Caster, Sky, lights_of};
use lightkiln_client::passes::shadow::{ShadowPlan, reference};
use lightkiln_client::scene::LoadedScene;
use lightkiln_proto::relight::Limit;

/// Texels along a side of a shadow map.
const SHADOW_SIDE: u32 = 1024;

fn main() -> Result<(), Box<dyn Error>> {
    let [_, folder, x, y, z] = &std::env::args().collect::<Vec<_>>()[..] else {
        return Err("give a bundle's folder and a point in metres".into());
    };
    let point = Vec3::new(x.parse()?, y.parse()?, z.parse()?);
    let source = Source::bundle(folder)?;
    let scene = LoadedScene::load(&source)?;
    let light = prt::load(&source, &scene)?;

    // Direct light comes from shadow maps, as on a graphics adapter.
    let (lamps, _) = lights_of(&scene.manifest);
    let plan = ShadowPlan::new(&Caster::of(&lamps), scene.manifest.bounds_m, SHADOW_SIDE, None)?;
    let maps = reference::draw(&scene, &plan);
    let unshadowed = Unshadowed { sky: Sky::of(&lamps), emitter_scale: &[] };
    let lit = LitScene { scene: &scene, plan: &plan, maps: &maps, unshadowed };

    // Bounces until they converge, then the receiver nearest to the point.
    let settled = light.settled(&lit, Limit::default()).light;
    let receivers = &light.transport.receivers;
    let distance = |slot: &usize| receivers.position_m[*slot].truncate().distance(point);
    let nearest = (0..receivers.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)));
    let slot = nearest.ok_or("the bake has no receivers")?;
    let e_ind = settled.indirect(slot as u32).truncate();
    println!(
        "{e_ind} W/m2 at {} m, facing {}",
        receivers.position_m[slot].truncate(),
        receivers.normal[slot].truncate()
    );
    Ok(())
}
