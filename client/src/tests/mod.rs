//! Tests across rooms: shaders are valid and agree with their Rust twins, adapter and reference agree in numbers, light
//! obeys physics, and light can follow the view.

mod adapter;
mod detail;
mod details;
pub(crate) mod facing;
mod factors;
mod field;
mod fog;
mod formula;
mod glass;
mod light;
mod many;
pub(crate) mod objects;
mod panorama;
mod receivers;
mod rects;
mod room;
mod shaders;
mod shadows;
mod show;
mod under_way;

use glam::Vec3;
use lightkiln_proto::relight::PatchTable;

use crate::bake::LoadedBake;
use crate::fixture;
use crate::lightmap::LightmapLight;
use crate::passes::shade::Surface;
use crate::passes::shade::lamps::seen_light;
use crate::passes::shade::specular::Gloss;
use crate::passes::shadow::ShadowPlan;
use crate::passes::shadow::reference::ShadowMaps;
use crate::preview::{Prepared, View};
use crate::scene::LoadedScene;

/// The fixture's view of a bake, small enough for the processor.
pub(crate) fn view_of(bake: &LoadedBake) -> View {
    let (view, notes) = View::of_bake(bake, None, None).unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    View { width: 160, height: 120, shadow_side: 512, emitter_scale: vec![1.5], ..view }
}

/// The fixture over patches with its view.
pub(crate) fn fixture_view() -> (LoadedBake, View) {
    let bake = fixture::prt_bake(&fixture::prt_contents());
    let view = view_of(&bake);
    (bake, view)
}

/// The same bake once more, its light as the type that it is.
pub(crate) fn fixture_light() -> (LoadedScene, LightmapLight<PatchTable>) {
    fixture::prt_light(&fixture::prt_contents())
}

/// A view prepared for either backend.
pub(crate) fn prepared<'a>(bake: &'a LoadedBake, view: &'a View) -> Prepared<'a> {
    Prepared::new(bake, view).unwrap()
}

/// A point of a surface of draw `draw`, outside of any lightmap.
pub(crate) fn surface_at(position: Vec3, normal: Vec3, draw: u32) -> Surface {
    Surface {
        position,
        normal,
        facet: normal,
        towards: normal,
        draw,
        front: true,
        lightmap_texel: [0.0; 2],
        lightmap_before: [0.0; 2],
    }
}

/// Irradiance of lamps at a point that is seen.
pub(crate) fn seen_irradiance(lamps: (&ShadowPlan, &ShadowMaps), position: Vec3, normal: Vec3) -> Vec3 {
    let plain = Gloss::of(Vec3::ONE, [0.0, -1.0], normal, normal);
    seen_light(lamps, &surface_at(position, normal, 0), position, &plain).irradiance
}
