//! Change of irradiance by objects, on the processor.

use glam::Vec3;
use lightkiln_proto::transfer::{Cap, Standing};

use super::Silhouettes;
use crate::error::Result;
use crate::lights::{Caster, Shape};
use crate::passes::direct::reference::face_of;
use crate::passes::direct::reference::share_by;
use crate::passes::shadow::reference::{ShadowMaps, draw_own};
use crate::passes::shadow::{SIGHT_SIDE, ShadowPlan};
use crate::scene::LoadedScene;

/// Surfaces of a bake that an object's middle sees.
#[derive(Clone, Debug)]
pub struct Sight {
    plan: ShadowPlan,
    maps: ShadowMaps,
}

/// An object where it stands, and what is in its sight.
#[derive(Clone, Debug)]
pub struct Effect<'a> {
    /// The object in its light.
    pub standing: Standing<'a>,
    /// Sight from its middle.
    pub sight: &'a Sight,
    /// It, as emitters see it.
    pub silhouettes: &'a Silhouettes,
}

impl Sight {
    /// From a point, past the bake's own surfaces alone.
    pub fn from(scene: &LoadedScene, middle_m: Vec3) -> Result<Self> {
        let plan = Self::plan(scene, middle_m)?;
        let maps = draw_own(scene, &plan);
        Ok(Self { plan, maps })
    }

    /// The cube at a point.
    pub fn plan(scene: &LoadedScene, middle_m: Vec3) -> Result<ShadowPlan> {
        let caster = Caster {
            position: middle_m,
            direction: -Vec3::Y,
            strength: Vec3::ONE,
            range: 0.0,
            cone: [0.0; 2],
            half_u_m: Vec3::ZERO,
            half_v_m: Vec3::ZERO,
            cells: [0; 2],
            shape: Shape::Point,
        };
        ShadowPlan::new(&[caster], scene.manifest.bounds_m, SIGHT_SIDE, None)
    }

    /// Share of a point of a surface that is in sight: v.
    pub fn share(&self, at_m: Vec3, facet: Vec3) -> f32 {
        let light = &self.plan.lights[0];
        share_by((&self.plan, &self.maps), face_of(&self.plan, light, at_m), light, at_m, facet)
    }
}

/// `Σ v h ΔE` of all objects but one at a surface, W·m⁻²; h is the share of an object that nearer ones leave in sight. And what points of
/// emitters give to that one, whose surface it is.
pub fn change(effects: &[Effect<'_>], but: Option<usize>, at_m: Vec3, normal: Vec3, facet: Vec3) -> Vec3 {
    let is_other =
        |(index, effect): &(usize, &Effect<'_>)| but != Some(*index) && effect.standing.reaches(at_m);
    let near: Vec<&Effect<'_>> =
        effects.iter().enumerate().filter(is_other).map(|(_, effect)| effect).collect();
    let caps: Vec<Cap> = if near.len() > 1 {
        near.iter().map(|effect| effect.standing.cap(at_m)).collect()
    } else {
        Vec::new()
    };
    let of = |(index, effect): (usize, &&Effect<'_>)| {
        let kept = effect.silhouettes.kept(at_m, normal) * effect.standing.fade(at_m);
        let change = effect.standing.change(at_m, normal) - kept;
        if change == Vec3::ZERO {
            return change;
        }
        let left = |own: &Cap| caps.iter().map(|nearer| 1.0 - own.hidden_by(nearer)).product::<f32>();
        change * effect.sight.share(at_m, facet) * caps.get(index).map_or(1.0, left)
    };
    let given = but.and_then(|own| effects.get(own)).map(|own| own.silhouettes.given(at_m, normal, facet));
    near.iter().enumerate().map(of).sum::<Vec3>() + given.unwrap_or_default()
}
