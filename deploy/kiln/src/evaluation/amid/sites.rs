//! Places at which an object amid a bake is measured: receivers of the bake near it and elsewhere, and its own.

use glam::{Affine3A, Vec3};
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::passes::atlas::Lightmap;
use lightkiln_worker::geometry::{Geometry, Site};
use lightkiln_worker::kinds::field::is_inside;

use crate::failure::{Failure, Result};

/// Free space before a place of the object's own, in metres, within which it touches something else.
const TOUCH_M: f32 = 0.02;

/// How many places there are at most, of each sort.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Near the object.
    pub near: usize,
    /// Farther away.
    pub elsewhere: usize,
    /// On its own surface.
    pub own: usize,
}

/// A receiver that is measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredSite {
    /// Its slot.
    pub slot: usize,
    /// Its place.
    pub site: Site,
    /// Receivers for which it stands.
    pub weight: f64,
    /// Whether it is near the object.
    pub is_near: bool,
}

/// Receivers that are measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sites {
    /// Of the bake.
    pub statics: Vec<MeasuredSite>,
    /// Of the object, where it stands.
    pub own: Vec<MeasuredSite>,
}

impl Sites {
    /// Evenly chosen of each sort; none within anything, and none where the object touches the scene.
    pub(super) fn of(
        (bake, of_object): (&LoadedBake, &LoadedBake),
        (alone, together): (&Geometry, &Geometry),
        place: &Affine3A,
        (middle_m, near_m): (Vec3, f32),
        counts: &Counts,
    ) -> Result<Self> {
        let is_free = |site: &Site| !is_inside(together, together.lifted(site.position_m, site.normal));
        let is_near = |site: &Site| site.position_m.distance(middle_m) < near_m;
        let map = lightmap_of(bake)?;
        let mut statics = Vec::new();
        for (count, near) in [(counts.near, true), (counts.elsewhere, false)] {
            let all = all_of(&map, &Affine3A::IDENTITY).filter(|(_, site)| is_near(site) == near).collect();
            statics.extend(spread(all, count, near, is_free));
        }
        let is_open = |site: &Site| {
            // From within the object: it may lie in the very plane of what it touches.
            let from_m = site.position_m - TOUCH_M * site.normal;
            is_free(site) && alone.tracer.closest(from_m, site.normal, 2.0 * TOUCH_M).is_none()
        };
        let own = spread(all_of(&lightmap_of(of_object)?, place).collect(), counts.own, true, is_open);
        Ok(Self { statics, own: own.collect() })
    }
}

fn lightmap_of(bake: &LoadedBake) -> Result<Lightmap<'_>> {
    bake.light.lightmap(&bake.scene).ok_or_else(|| {
        let what = format!(
            "objects are measured at receivers, and bakes of kind '{}' have none",
            bake.scene.manifest.kind
        );
        Failure::bad_input(what).try_this("a bake of another kind with voxels=on")
    })
}

/// Receivers by slot, of a bake whose place that is.
fn all_of<'a>(map: &Lightmap<'a>, place: &'a Affine3A) -> impl Iterator<Item = (usize, Site)> + 'a {
    let receivers = map.receivers;
    (0..receivers.len()).map(move |slot| {
        let position_m = place.transform_point3(receivers.position_m[slot].truncate());
        let normal = place.transform_vector3(receivers.normal[slot].truncate()).normalize_or(Vec3::Y);
        (slot, Site { position_m, normal, face_normal: normal })
    })
}

/// About so many of them, of which those are taken that are free.
fn spread(
    all: Vec<(usize, Site)>,
    count: usize,
    is_near: bool,
    is_free: impl Fn(&Site) -> bool,
) -> impl Iterator<Item = MeasuredSite> {
    let step = (all.len() / count.max(1)).max(1);
    let some = all.into_iter().step_by(step).filter(move |(_, site)| is_free(site));
    some.map(move |(slot, site)| MeasuredSite { slot, site, weight: step as f64, is_near })
}
