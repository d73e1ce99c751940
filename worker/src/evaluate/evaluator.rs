//! The evaluation of one bake, light by light.

use std::collections::BTreeMap;

use glam::DVec3;
use lightkiln_proto::ids::Digest;
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::prt::reconstruct::Rgb;
use lightkiln_proto::prt::{BlockKey, Texel};
use lightkiln_proto::scene::LightKind;

use super::baked::{Baked, Incoming, Settled, names};
use super::classes::{Anew, Classes, wide};
use super::error::EvaluationError;
use super::figures::{Figures, Pair};
use super::lights::{Chosen, Openness, TestLight, default_lights};
use super::sample::{Sample, site_of};
use super::solid::check_place;
use crate::prt::World;
use crate::reference::{Estimate, IrradianceEstimate, Lighting, LightingError, Precision, Reference};
use crate::task::{Cancelled, Progress};

/// Points over a panel that give E_dir at every receiver of the bake.
const PANEL_POINTS: u32 = 64;
/// Receivers without baked light are left out of the figures where the reference has less than this share of its mean:
/// insides of solids.
const LIGHTLESS_SHARE: f64 = 1e-3;

/// How much work to spend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Strata of area, with a receiver in each. More → surer figures, more time.
    pub receivers: u32,
    /// How sure the reference must be.
    pub precision: Precision,
    /// Cluster cells whose factors are made anew to tell factorisation from quantisation. More → surer, more time.
    pub cells: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self { receivers: 2000, precision: Precision::default(), cells: 12 }
    }
}

/// A bake and everything that it is measured with.
pub struct Evaluator {
    world: World,
    baked: Baked,
    /// Stage index of each receiver by cluster.
    stage_of: Vec<Vec<u32>>,
    sample: Sample,
    anew: Anew,
    options: Options,
    back_share_max: f32,
}

/// What one light showed.
#[derive(Clone, Debug)]
pub struct LightResult {
    /// The light.
    pub light: TestLight,
    /// Error figures.
    pub figures: Figures,
    /// The error by class.
    pub classes: Classes,
    /// Baked E_ind of the sample's receivers, W·m⁻²; zero for those that the bake left out as unreachable.
    pub baked: Vec<DVec3>,
    /// E_ind of the same by full-precision, full-rank transport, W·m⁻².
    pub full_rank: Vec<DVec3>,
    /// The reference of the same.
    pub reference: Vec<IrradianceEstimate>,
    /// Which of the sample the figures count: all but insides of solids.
    pub counted: Vec<bool>,
    /// The relit bake.
    pub settled: Settled,
}

impl Evaluator {
    /// Makes the bake's world anew from its scene bundle and decodes its chunks.
    ///
    /// Errors when the scene is not the one of the manifest, or when it is prepared otherwise now than it was then.
    pub fn new(
        manifest: &Manifest,
        scene: Vec<u8>,
        bytes: impl Fn(Digest) -> Result<Vec<u8>, EvaluationError> + Sync,
        options: Options,
        progress: &Progress,
    ) -> Result<Self, EvaluationError> {
        let found = Digest::of(&scene);
        if found != manifest.scene {
            return Err(EvaluationError::OtherScene { wanted: manifest.scene, found });
        }
        let world = World::rebuild(scene, &manifest.settings, progress).map_err(EvaluationError::Prepare)?;
        let baked = Baked::decode(manifest, bytes)?;
        let stage_of = same_stage(manifest, &world, &baked)?;
        let sample = Sample::new(&world, options.receivers);
        let anew = Anew::trace(&world, &manifest.settings, &sample, options.cells, progress)?;
        let back_share_max = manifest.settings.probe_back_face_max;
        Ok(Self { world, baked, stage_of, sample, anew, options, back_share_max })
    }

    /// The world.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The decoded bake.
    pub fn baked(&self) -> &Baked {
        &self.baked
    }

    /// The receivers that are measured.
    pub fn sample(&self) -> &Sample {
        &self.sample
    }

    /// Cluster cells and clusters whose factors were made anew.
    pub fn made_anew(&self) -> [usize; 2] {
        [self.anew.cells(), self.anew.clusters()]
    }

    /// Lights chosen from the scene.
    pub fn default_lights(&self) -> Chosen {
        default_lights(&self.world)
    }

    /// Refuses lights that stand inside solids; leaves out suns and skies where the scene has no opening, and says so.
    ///
    /// Errors when that leaves none.
    pub fn usable(&self, lights: Vec<TestLight>) -> Result<Chosen, EvaluationError> {
        let mut openness = None;
        let mut usable = Chosen::default();
        for light in lights {
            check_place(&self.world, &light, self.back_share_max)?;
            let from_outside =
                |kind: &LightKind| matches!(kind, LightKind::Sky { .. } | LightKind::Sun { .. });
            let needs_opening = light.lighting.lights.iter().any(|lamp| from_outside(&lamp.kind));
            let openness = openness.get_or_insert_with(|| Openness::of(&self.world));
            if needs_opening && !openness.has_opening() {
                let note = format!("light '{}' is left out: the scene has no opening to the sky", light.name);
                usable.notes.push(note);
            } else if light.lighting.emitter_scale > 0.0 && self.emits_nothing() {
                usable.notes.push(format!("light '{}' is left out: nothing in the scene emits", light.name));
            } else {
                usable.lights.push(light);
            }
        }
        if usable.lights.is_empty() {
            return Err(EvaluationError::NoLight { problem: usable.notes.join("; ") });
        }
        Ok(usable)
    }

    fn emits_nothing(&self) -> bool {
        self.world.scene.materials.iter().all(|material| material.emissive == [0.0; 3])
    }

    /// The reference of the scene under some light.
    pub fn reference(&self, lighting: &Lighting) -> Result<Reference<'_>, LightingError> {
        Reference::new(&self.world.scene, &self.world.images, &self.world.geometry, lighting)
    }

    /// Measures the bake under one light.
    ///
    /// Errors when the light reaches no surface at all.
    pub fn measure(&self, light: &TestLight, progress: &Progress) -> Result<LightResult, EvaluationError> {
        let reference = self.reference(&light.lighting)?;
        let settled = self.relit(&reference, &light.lighting, progress)?;
        let sites = self.sample.sites(&self.world.stage);
        let estimates = reference.irradiance(&sites, &self.options.precision, progress)?;
        let lit = estimates.iter().any(|e| e.indirect.luminance() > 0.0 || e.direct.luminance() > 0.0);
        if !lit {
            let problem = "it reaches no surface of the scene; move it or turn it";
            return Err(LightingError::new(&light.name, problem).into());
        }
        let baked = self.baked_at_sample(&settled);
        let counted = self.counted(&estimates);
        let scale = light.lighting.emitter_scale;
        let near =
            self.sample.receivers.iter().map(|sampled| self.near_at(sampled.receiver, &settled)).collect();
        let full = self.anew.full_rank(near, &settled, scale);
        let figures = Figures::of(&self.pairs(&baked, &estimates, &counted));
        let transport = Figures::of(&self.pairs(&full, &estimates, &counted)).rel_rmse;
        let mean = figures.mean_irradiance.max(f64::MIN_POSITIVE);
        let factors = self.anew.factor_errors(&self.world, &self.baked, &settled, scale);
        let [factorisation, quantisation] = factors.map(|error| error / mean);
        let classes = Classes { transport, factorisation, quantisation };
        Ok(LightResult {
            light: light.clone(),
            figures,
            classes,
            baked,
            full_rank: full,
            reference: estimates,
            counted,
            settled,
        })
    }

    /// The bake relit until bounces converge, E_dir by exact rays.
    fn relit(
        &self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Settled, Cancelled> {
        let direct = self.baked.direct(|at| -> Result<Rgb, Cancelled> {
            progress.check()?;
            let site = at.site(|(c, r)| site_of(&self.world.stage, self.stage_of[c][r]));
            Ok(reference.direct_irradiance(&site, PANEL_POINTS).as_vec3().to_array())
        })?;
        let mut sky = [[0.0; 3]; 2];
        for lamp in &lighting.lights {
            if let LightKind::Sky { zenith, horizon } = &lamp.kind {
                for (sum, colour) in sky.iter_mut().zip([zenith, horizon]) {
                    *sum = [0, 1, 2].map(|c| sum[c] + colour[c] * lamp.strength[c]);
                }
            }
        }
        Ok(self.baked.settle(&Incoming { direct, sky, emitter_scale: lighting.emitter_scale }))
    }

    fn baked_at_sample(&self, settled: &Settled) -> Vec<DVec3> {
        let of = |receiver: u32| {
            let (c, r) = self.place(receiver)?;
            Some(wide(settled.indirect[c][r]))
        };
        self.sample.receivers.iter().map(|sampled| of(sampled.receiver).unwrap_or_default()).collect()
    }

    /// What near hits give a receiver.
    fn near_at(&self, receiver: u32, settled: &Settled) -> Rgb {
        self.place(receiver).map_or([0.0; 3], |(c, r)| settled.near_of(c, r))
    }

    /// Cluster of a receiver of the stage and its place there; `None` for those that no light can reach.
    pub fn place(&self, receiver: u32) -> Option<(usize, usize)> {
        let receiver = &self.world.stage.receivers[receiver as usize];
        self.baked.place(self.world.stage.blocks[receiver.block as usize].key, receiver.texel)
    }

    /// All but receivers that neither the bake nor the reference lights.
    fn counted(&self, estimates: &[IrradianceEstimate]) -> Vec<bool> {
        let total: f64 = estimates.iter().map(|estimate| estimate.indirect.luminance()).sum();
        let least = LIGHTLESS_SHARE * total / estimates.len().max(1) as f64;
        let counts = |(receiver, estimate): (u32, &IrradianceEstimate)| {
            self.place(receiver).is_some() || estimate.indirect.luminance() > least
        };
        self.sample.receivers.iter().map(|sampled| sampled.receiver).zip(estimates).map(counts).collect()
    }

    fn pairs(&self, found: &[DVec3], estimates: &[IrradianceEstimate], counted: &[bool]) -> Vec<Pair> {
        let all = self.sample.receivers.iter().zip(found).zip(estimates).zip(counted);
        all.filter(|(_, counted)| **counted)
            .map(|(((sampled, found), estimate), _)| {
                let reference: Estimate = estimate.indirect;
                Pair { area_m2: sampled.area_m2, found: *found, reference }
            })
            .collect()
    }
}

/// Stage index of each receiver by cluster; errors with the first thing in which stage and bake differ.
fn same_stage(manifest: &Manifest, world: &World, baked: &Baked) -> Result<Vec<Vec<u32>>, EvaluationError> {
    let other = |what: String| Err(EvaluationError::OtherStage { what });
    let stage = &world.stage;
    if stage.texel_m != manifest.texel_m {
        return other(format!("texels of {} m, not {} m", stage.texel_m, manifest.texel_m));
    }
    let keys: Vec<u64> = baked.probes().collect();
    if keys.len() != stage.probes.len()
        || !keys.iter().zip(&stage.probes).all(|(key, probe)| *key == probe.key)
    {
        return other(format!("{} probes, the bundle has {} or others", stage.probes.len(), keys.len()));
    }
    let key = |block: u32| stage.blocks[block as usize].key;
    let index_of: BTreeMap<(BlockKey, Texel), u32> = stage
        .receivers
        .iter()
        .zip(0..)
        .map(|(receiver, index)| ((key(receiver.block), receiver.texel), index))
        .collect();
    let mut stage_of = Vec::with_capacity(baked.clusters.len());
    for cluster in &baked.clusters {
        let found: Option<Vec<u32>> = names(cluster).map(|name| index_of.get(&name).copied()).collect();
        match found {
            Some(found) => stage_of.push(found),
            None => return other("a receiver of the bundle is not there".into()),
        }
    }
    Ok(stage_of)
}
