//! Irradiance gathered straight from the radiance of the receivers that rays meet: what probes, basis and factors stand
//! in for. The difference to the reconstructed light is the error of transport.

use std::collections::BTreeMap;
use std::f32::consts::PI;

use anyhow::{Context, Result};
use lightkiln_proto::prt::reconstruct::Rgb;
use lightkiln_worker::prt::{Surface, World};
use lightkiln_worker::rays::sampling::{R2, cosine_hemisphere, seed_of, tangent_frame};
use rayon::prelude::*;

use super::{Lighting, LocalBake, RelitReceiver};

/// For each of `light`, `π/N Σ_n ρ/π (E_dir + E_ind)` over what N cosine-distributed rays meet, plus the sky; emission is
/// left out, as it is in `light.indirect` less its emitters.
///
/// `light` must be complete: every receiver of the bake, converged.
pub fn gathered(
    bake: &LocalBake,
    light: &[RelitReceiver],
    lighting: &Lighting,
    rays: u32,
) -> Result<Vec<Rgb>> {
    let bytes = |name: &str| -> Result<&[u8]> {
        let digest = bake.outputs.get(name).with_context(|| format!("no output '{name}'"))?;
        Ok(bake.artefacts.get(digest).with_context(|| format!("no bytes of '{name}'"))?.as_slice())
    };
    let world = World::from_artefacts(bytes("scene")?, bytes("stage")?)?;
    let mut radiance_of: BTreeMap<(&str, [u16; 2]), Rgb> = BTreeMap::new();
    for receiver in light {
        let direct = (lighting.direct)(receiver.position_m, receiver.normal);
        let radiance = [0, 1, 2].map(|c| receiver.albedo[c] / PI * (direct[c] + receiver.indirect[c]));
        radiance_of.insert((&receiver.block, receiver.texel), radiance);
    }
    let radiance: Vec<Rgb> = world
        .stage
        .receivers
        .iter()
        .map(|r| radiance_of.get(&(world.stage.blocks[r.block as usize].name.as_str(), r.texel)).copied())
        .map(Option::unwrap_or_default)
        .collect();
    Ok(light
        .par_iter()
        .enumerate()
        .map(|(index, r)| gather(&world, &radiance, lighting, r, rays, index))
        .collect())
}

fn gather(
    world: &World,
    radiance: &[Rgb],
    lighting: &Lighting,
    receiver: &RelitReceiver,
    rays: u32,
    index: usize,
) -> Rgb {
    let points = R2::new(seed_of(&[index as u64, 77]));
    let (tangent, bitangent) = tangent_frame(receiver.normal);
    let origin = receiver.position_m + receiver.normal * (4.0 * world.geometry.tracer.ray_offset_m());
    let mut sum = [0.0; 3];
    for ray in 0..rays {
        let local = cosine_hemisphere(points.point(ray));
        let direction = tangent * local.x + bitangent * local.y + receiver.normal * local.z;
        let met = match world.geometry.tracer.closest(origin, direction, f32::INFINITY) {
            None => {
                let [zenith, horizon] = lighting.sky;
                let up = direction.y.max(0.0);
                [0, 1, 2].map(|c| horizon[c] + (zenith[c] - horizon[c]) * up)
            }
            Some(hit) => match world.surface_at(&hit) {
                Surface::Receiver(other) => radiance[other as usize],
                Surface::Dark => [0.0; 3],
            },
        };
        sum = [0, 1, 2].map(|c| sum[c] + met[c] * PI / rays as f32);
    }
    sum
}
