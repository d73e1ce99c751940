//! Relights a bake by the run time's own passes until bounces have converged, with E_dir in closed form.

use anyhow::Result;
use glam::{DVec3, Vec3};
use lightkiln_proto::scene::{LightKind, SceneLight};
use lightkiln_worker::geometry::Site;
use lightkiln_worker::reference;

use super::{Decoded, LocalBake, clusters};

/// Linear colour.
pub type Rgb = [f32; 3];

/// A receiver and its light.
#[derive(Clone, Debug)]
pub struct RelitReceiver {
    /// Position in metres.
    pub position_m: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Irradiance that did not come straight from a dynamic light, W·m⁻².
    pub indirect: Rgb,
}

/// Light on the scene besides its emissive surfaces.
pub struct Lighting<'a> {
    /// E_dir of dynamic lights at a point with a normal, W·m⁻².
    pub direct: &'a (dyn Fn(Vec3, Vec3) -> Rgb + Sync),
    /// Radiance of the sky at zenith and horizon.
    pub sky: [Rgb; 2],
}

impl Lighting<'_> {
    /// Nothing but emissive surfaces.
    pub const NONE: Lighting<'static> = Lighting { direct: &|_, _| [0.0; 3], sky: [[0.0; 3]; 2] };
}

/// Light at every receiver of a bake, in the order of clusters.
pub fn relit(bake: &LocalBake, lighting: &Lighting) -> Result<Vec<RelitReceiver>> {
    let decoded = Decoded::new(bake)?;
    let [zenith, horizon] = lighting.sky;
    let kind = LightKind::Sky { zenith, horizon };
    let sky = SceneLight { name: "sky".into(), kind, strength: [1.0; 3] };
    let under =
        reference::Lighting { lights: vec![sky], emitter_scale: 1.0, ..reference::Lighting::default() };
    let site = |slot: u32| {
        let [position_m, normal, _] = decoded.receiver(slot);
        Site { position_m, normal, face_normal: normal }
    };
    let direct = |site: &Site| DVec3::from((lighting.direct)(site.position_m, site.normal).map(f64::from));
    let light = decoded.lit(&under, |slot| vec![site(slot)], site, direct);
    let count: usize = clusters(bake)?.iter().map(|cluster| cluster.receivers.len()).sum();
    let receiver = |slot: u32| {
        let [position_m, normal, _] = decoded.receiver(slot);
        let indirect = light.settled.indirect(slot).truncate().to_array();
        RelitReceiver { position_m, normal, indirect }
    };
    Ok((0..count as u32).map(receiver).collect())
}
