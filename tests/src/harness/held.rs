//! A bake held against the path tracer at chosen receivers, both under the same lights.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use glam::{DVec3, Vec3};
use lightkiln_proto::scene::LightKind;
use lightkiln_worker::evaluate::{Baked, EvaluationError, Incoming, Place, Settled, site_of};
use lightkiln_worker::prt::World;
use lightkiln_worker::prt::stage::Receiver;
use lightkiln_worker::reference::{Lighting, Precision, Reference, luminance};
use lightkiln_worker::task::Progress;

use super::{LocalBake, bake};

/// Points over a panel that give E_dir at a receiver.
const PANEL_POINTS: u32 = 64;

/// A bake with the world that it was made in.
pub struct Held {
    /// The bake.
    pub bake: LocalBake,
    /// Scene, receivers and triangles.
    pub world: World,
    /// The decoded chunks.
    pub baked: Baked,
}

/// A bake under some lights.
pub struct Lit<'a> {
    held: &'a Held,
    reference: Reference<'a>,
    settled: Settled,
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
    pub fn new(scene: Vec<u8>, settings: &serde_json::Value) -> Result<Self> {
        let bake = bake(scene, settings)?;
        let bytes = |name: &str| -> Result<&[u8]> {
            let digest = bake.outputs.get(name).with_context(|| format!("no output '{name}'"))?;
            Ok(bake.artefacts.get(digest).with_context(|| format!("no bytes of '{name}'"))?.as_slice())
        };
        let world = World::from_artefacts(bytes("scene")?, bytes("stage")?)?;
        let baked = Baked::decode(&bake.manifest, |digest| {
            let found = bake.artefacts.get(&digest).map(|bytes| bytes.as_ref().clone());
            found.ok_or_else(|| EvaluationError::Missing { digest, source: "no task gave it".into() })
        })?;
        Ok(Self { bake, world, baked })
    }

    /// Receivers that `keep` says yes to, ascending.
    pub fn receivers(&self, keep: impl Fn(&Receiver) -> bool) -> Vec<u32> {
        let receivers = &self.world.stage.receivers;
        (0..receivers.len() as u32).filter(|&index| keep(&receivers[index as usize])).collect()
    }

    /// Lets light bounce in the bake.
    pub fn under(&self, lighting: &Lighting) -> Result<Lit<'_>> {
        let world = &self.world;
        let reference = Reference::new(&world.scene, &world.images, &world.geometry, lighting)?;
        let receivers = 0..world.stage.receivers.len() as u32;
        let stage_of: BTreeMap<Place, u32> =
            receivers.filter_map(|index| Some((self.place(index)?, index))).collect();
        let direct = self.baked.direct(|at| -> Result<_> {
            let site = at.site(|place| site_of(&world.stage, stage_of[&place]));
            Ok(reference.direct_irradiance(&site, PANEL_POINTS).as_vec3().to_array())
        })?;
        let mut sky = [[0.0; 3]; 2];
        for light in &lighting.lights {
            if let LightKind::Sky { zenith, horizon } = &light.kind {
                sky = [zenith, horizon].map(|colour| [0, 1, 2].map(|c| colour[c] * light.strength[c]));
            }
        }
        let settled = self.baked.settle(&Incoming { direct, sky, emitter_scale: lighting.emitter_scale });
        Ok(Lit { held: self, reference, settled })
    }

    /// Cluster of a receiver and its place there; `None` for those that no light can reach.
    pub fn place(&self, receiver: u32) -> Option<(usize, usize)> {
        let receiver = &self.world.stage.receivers[receiver as usize];
        self.baked.place(self.world.stage.blocks[receiver.block as usize].key, receiver.texel)
    }
}

impl Lit<'_> {
    /// E_ind of a receiver by the bake, W·m⁻²; 0 where no light can come.
    pub fn baked(&self, receiver: u32) -> DVec3 {
        let found = self.held.place(receiver).map(|(c, r)| self.settled.indirect[c][r]);
        Vec3::from(found.unwrap_or_default()).as_dvec3()
    }

    /// E_ind of receivers by both, each path-traced until its standard error is `rel_error` of it.
    pub fn compared(&self, receivers: &[u32], rel_error: f64) -> Result<Vec<Compared>> {
        let stage = &self.held.world.stage;
        let sites: Vec<_> = receivers.iter().map(|&receiver| site_of(stage, receiver)).collect();
        let precision = Precision { rel_error, paths_max: 1 << 14 };
        let found = self.reference.irradiance(&sites, &precision, &Progress::new())?;
        let pairs = receivers.iter().zip(found);
        Ok(pairs
            .map(|(&receiver, estimate)| Compared {
                position_m: stage.receivers[receiver as usize].position_m,
                baked: luminance(self.baked(receiver)),
                reference: estimate.indirect.luminance(),
                error: estimate.indirect.luminance_error,
            })
            .collect())
    }
}
