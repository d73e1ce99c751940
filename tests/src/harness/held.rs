//! A bake held against the path tracer at chosen receivers, both under the same lights.

use std::sync::Arc;

use anyhow::{Context, Result};
use glam::{DVec3, Vec3};
use lightkiln_worker::factors::Light;
use lightkiln_worker::geometry::Site;
use lightkiln_worker::lightmap::{Receiver, World};
use lightkiln_worker::reference::{Lighting, Precision, Reference, Target, luminance};
use lightkiln_worker::task::Progress;

use super::{Decoded, LocalBake, Recipe, bake_in_world};

/// Points over rectangles that give E_dir at a receiver.
const RECT_POINTS: u32 = 64;

/// A bake with the world that it was made in.
pub struct Held {
    /// The bake.
    pub bake: LocalBake,
    /// Scene, receivers and triangles.
    pub world: Arc<World>,
    /// The decoded chunks.
    pub decoded: Decoded,
    /// Receiver at each slot.
    receiver_of: Vec<u32>,
}

/// A bake under some lights.
pub struct Lit<'a> {
    held: &'a Held,
    reference: Reference<'a>,
    light: Light,
}

/// E_ind of one receiver, luminance in W·m⁻².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compared {
    /// Position in metres.
    pub position_m: Vec3,
    /// Of the bake; 0 where no light can come.
    pub baked: f64,
    /// Of the path tracer.
    pub reference: f64,
    /// Standard error of the latter.
    pub error: f64,
}

impl Held {
    /// Bakes a scene bundle.
    pub fn new(scene: Vec<u8>, recipe: &Recipe) -> Result<Self> {
        let (bake, world) = bake_in_world(scene, recipe)?;
        let decoded = Decoded::new(&bake)?;
        let mut by_slot: Vec<(u32, u32)> = (0..world.lightmap.receivers.len() as u32)
            .filter_map(|receiver| {
                let (block, texel) = world.lightmap.name_of(receiver);
                Some((decoded.slot(block, texel)?, receiver))
            })
            .collect();
        by_slot.sort_unstable();
        let receiver_of = by_slot.into_iter().map(|(_, receiver)| receiver).collect();
        Ok(Self { bake, world, decoded, receiver_of })
    }

    /// Receivers that `keep` says yes to, ascending.
    pub fn receivers(&self, keep: impl Fn(&Receiver) -> bool) -> Vec<u32> {
        let receivers = &self.world.lightmap.receivers;
        (0..receivers.len() as u32).filter(|&index| keep(&receivers[index as usize])).collect()
    }

    /// Lets light bounce in the bake.
    pub fn under(&self, lighting: &Lighting) -> Result<Lit<'_>> {
        let reference = Reference::new(&self.world.geometry, lighting)?;
        let site = |slot: u32| self.site(self.receiver_of[slot as usize]);
        let sites = |slot: u32| self.world.lit_points_of(self.receiver_of[slot as usize]);
        let direct = |site: &Site| reference.direct_irradiance(site, RECT_POINTS);
        let light = self.decoded.lit(lighting, sites, site, direct);
        Ok(Lit { held: self, reference, light })
    }

    fn site(&self, receiver: u32) -> Site {
        self.world.lightmap.receivers[receiver as usize].site()
    }

    /// Slot of a receiver; `None` for those that no light can reach.
    pub fn slot(&self, receiver: u32) -> Option<u32> {
        let (block, texel) = self.world.lightmap.name_of(receiver);
        self.decoded.slot(block, texel)
    }
}

impl Lit<'_> {
    /// Light at receivers after the last bounce, with the λ that gave it.
    pub fn light(&self) -> &Light {
        &self.light
    }

    /// The path tracer under the same lights.
    pub fn reference(&self) -> &Reference<'_> {
        &self.reference
    }

    /// E_ind of a receiver by the bake, W·m⁻²; 0 where no light can come.
    pub fn baked(&self, receiver: u32) -> DVec3 {
        let found = self.held.slot(receiver).map(|slot| self.light.settled.indirect(slot));
        found.unwrap_or_default().truncate().as_dvec3()
    }

    /// E_ind of receivers by both, means over the points of their texels, each path-traced until its standard error is
    /// `rel_error` of it.
    pub fn compared(&self, receivers: &[u32], rel_error: f64) -> Result<Vec<Compared>> {
        self.compared_at(receivers, rel_error, |receiver| self.held.world.gathering_points_of(receiver))
    }

    /// The same, with the reference's mean over other points.
    pub fn compared_at(
        &self,
        receivers: &[u32],
        rel_error: f64,
        points: impl Fn(u32) -> Vec<Site>,
    ) -> Result<Vec<Compared>> {
        let sites: Vec<_> = receivers.iter().map(|&receiver| self.held.site(receiver)).collect();
        let target =
            |(&receiver, site): (&u32, &Site)| Target { points: points(receiver), ..Target::of(*site) };
        let targets: Vec<Target> = receivers.iter().zip(&sites).map(target).collect();
        let precision = Precision { rel_error, paths_max: 1 << 14 };
        let found =
            self.reference.mean_irradiance(&targets, &precision, &Progress::new()).context("cancelled")?;
        let pairs = receivers.iter().zip(&sites).zip(found);
        Ok(pairs
            .map(|((&receiver, site), estimate)| Compared {
                position_m: site.position_m,
                baked: luminance(self.baked(receiver)),
                reference: estimate.indirect.luminance(),
                error: estimate.indirect.luminance_error,
            })
            .collect())
    }
}
