//! A bake with a field as evaluation sees it: its surfaces, which are those of a relightable bake, and its free space.

use glam::{DVec3, Vec3, Vec4};
use lightkiln_proto::harmonics::{ShBasis, relight_direction};
use lightkiln_proto::ids::Digest;
use lightkiln_proto::jobs::TaskSpec;
use lightkiln_proto::kinds::field::{
    Body, FIELD, FieldPart, FieldTable, PROBE_ROWS, TetrahedronSet, decode_field, decode_tetrahedra,
};
use lightkiln_proto::kinds::prt::Settings;
use lightkiln_proto::manifest::Manifest;
use lightkiln_proto::relight::PatchTable;
use rayon::prelude::*;

use super::capture::Capture;
use super::readings::{Agreement, CLASSES, Reading};
use super::truth::Truth;
use crate::emitters::EmitterSet;
use crate::evaluate::{
    Answer, ChunkBytes, ErrorClass, Evaluated, EvaluatedLightmap, EvaluationError, MappedIncoming, Measure,
    Place, Relit, Sample, Sampled, TestLight,
};
use crate::factors::{FactoredBake, Threads, decoded};
use crate::geometry::{Geometry, Site, Strata};
use crate::kinds::{BakeKinds, prt};
use crate::rays::Hit;
use crate::rays::sampling::{Sequence, seed_of, uniform_sphere};
use crate::reference::{Lighting, Reference, luminance};
use crate::task::{Cancelled, Progress};

/// Nearest to a surface that light is measured, in metres.
const CLEARANCE_M: f32 = 0.02;
/// Places beside surfaces are at most so far off them, in metres.
const BESIDE_M: f32 = 0.5;
/// Rays that look whether a place is free.
const LOOK_RAYS: u32 = 32;
/// Places that are tried for each that is wanted.
const TRIES: u32 = 64;

/// Surfaces of a bake with a field.
pub struct FieldBake {
    surfaces: FactoredBake<PatchTable>,
    field: FieldTable,
}

/// Light of a bake's probes, as evaluation asks for it.
pub trait SpaceLight: Send + Sync {
    /// The scene.
    fn geometry(&self) -> &Geometry;

    /// The field.
    fn field(&self) -> &FieldTable;

    /// Coefficients at probes under some lights; bounces until they changed no more, and whether they did before the last one allowed.
    fn rows(
        &self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<(Vec<Vec4>, (usize, bool)), Cancelled>;

    /// The light that alone it can be measured under.
    fn own_light(&self) -> Option<TestLight> {
        None
    }
}

/// Free space of a bake.
struct FieldSpace {
    light: Box<dyn SpaceLight>,
    emitters: EmitterSet,
    /// Places at which causes of error are told apart, each with two directions.
    points_m: Vec<Vec3>,
}

/// A bake as it lights free space.
pub fn in_space(light: Box<dyn SpaceLight>) -> Box<dyn Evaluated> {
    let emitters = EmitterSet::new(light.geometry());
    Box::new(FieldSpace { light, emitters, points_m: Vec::new() })
}

/// Parts of a field, and tetrahedra between its probes.
pub type Parts = (Vec<FieldPart>, Option<TetrahedronSet>);

/// The parts of a bake's field, and its tetrahedra, whose chunk has that `role`, if there is one.
pub fn parts(
    manifest: &Manifest,
    role: Option<&'static str>,
    bytes: ChunkBytes,
) -> Result<Parts, EvaluationError> {
    let parts = manifest.chunks(FIELD).iter().map(|chunk| decoded(chunk, bytes, decode_field));
    let parts: Vec<_> = parts.collect::<Result<_, EvaluationError>>()?;
    let tetrahedra = role.and_then(|role| manifest.chunks(role).first());
    let tetrahedra = tetrahedra.map(|chunk| decoded(chunk, bytes, decode_tetrahedra)).transpose()?;
    Ok((parts, tetrahedra))
}

/// Makes the bake's world anew and decodes its chunks; those of tetrahedra have that `role`, if it has some. `first` are the scene, its
/// first tasks, the task kind that plans the rest, and those of surfaces which probes or walks light.
pub fn evaluated(
    kinds: &BakeKinds,
    manifest: &Manifest,
    first: (Vec<u8>, impl FnOnce(Digest) -> Vec<TaskSpec>, &str, &[&str]),
    relightable: &Settings,
    role: Option<&'static str>,
    (bytes, progress): (ChunkBytes, &Progress),
) -> Result<FieldBake, EvaluationError> {
    let surfaces = prt::evaluated_of(kinds, manifest, first, relightable.into(), bytes, progress)?;
    let (parts, tetrahedra) = parts(manifest, role, bytes)?;
    let field = FieldTable::join(&parts, tetrahedra.as_ref(), manifest.emitters.len(), surfaces.columns())?;
    manifest.body::<Body>()?.field.check(&field)?;
    Ok(FieldBake { surfaces, field })
}

impl Evaluated for FieldBake {
    fn geometry(&self) -> &Geometry {
        self.surfaces.geometry()
    }

    fn answer_at(&self, hit: &Hit) -> Answer {
        self.surfaces.answer_at(hit)
    }

    fn points_of(&self, place: &Place) -> Vec<Site> {
        self.surfaces.points_of(place)
    }

    fn lightmap(&self) -> Option<&dyn EvaluatedLightmap> {
        self.surfaces.lightmap()
    }

    fn in_space(self: Box<Self>) -> Option<Box<dyn Evaluated>> {
        Some(in_space(self))
    }

    fn by_walks(self: Box<Self>) -> Option<Box<dyn Evaluated>> {
        Box::new(self.surfaces).by_walks()
    }

    fn chunk_of(&self, place: &Place) -> Option<usize> {
        self.surfaces.chunk_of(place)
    }

    fn trace(&mut self, sample: &[Place], effort: usize, progress: &Progress) -> Result<(), Cancelled> {
        self.surfaces.trace(sample, effort, progress)
    }

    fn traced(&self) -> [usize; 2] {
        self.surfaces.traced()
    }

    fn relit<'a>(
        &'a self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Box<dyn Relit + 'a>, Cancelled> {
        self.surfaces.relit(reference, lighting, progress)
    }

    fn relit_by_maps<'a>(
        &'a self,
        lighting: &Lighting,
        direct: &MappedIncoming,
    ) -> Option<Box<dyn Relit + 'a>> {
        self.surfaces.relit_by_maps(lighting, direct)
    }
}

impl SpaceLight for FieldBake {
    fn geometry(&self) -> &Geometry {
        self.surfaces.geometry()
    }

    fn field(&self) -> &FieldTable {
        &self.field
    }

    fn rows(
        &self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<(Vec<Vec4>, (usize, bool)), Cancelled> {
        let light = self.surfaces.lit(reference, lighting, progress)?;
        let rows = self.field.relit(&Threads, &light.settled.lambda, &light.emitter_scale);
        Ok((rows, (light.settled.bounces as usize, light.settled.converged)))
    }
}

impl Evaluated for FieldSpace {
    fn geometry(&self) -> &Geometry {
        self.light.geometry()
    }

    fn own_light(&self) -> Option<TestLight> {
        self.light.own_light()
    }

    fn answer_at(&self, hit: &Hit) -> Answer {
        Answer::Place(Place { site: self.geometry().site_at(hit), number: None })
    }

    /// Half of them anywhere in free space, half 2 to 50 cm off surfaces; each point with two opposite directions.
    fn sample(&self, count: u32) -> Sample {
        let geometry = self.geometry();
        let [low_m, high_m] = geometry.near_bounds_m();
        let mut numbers = Sequence::new(seed_of(&[40]));
        let wanted = (count / 4).max(1);
        let mut anywhere = || low_m + (high_m - low_m) * Vec3::from([(); 3].map(|()| numbers.next_f32()));
        let inner: Vec<Vec3> = (0..TRIES * wanted).map(|_| anywhere()).collect();
        let mut numbers = Sequence::new(seed_of(&[41]));
        let beside = Strata::new(geometry, TRIES.min(8) * wanted).hits.into_iter().map(|hit| {
            let site = geometry.site_at(&hit);
            site.position_m + site.face_normal * (CLEARANCE_M + (BESIDE_M - CLEARANCE_M) * numbers.next_f32())
        });
        let beside: Vec<Vec3> = beside.collect();
        let free = |points_m: Vec<Vec3>| {
            let free: Vec<Vec3> =
                points_m.into_iter().filter(|&point_m| is_free(geometry, point_m)).collect();
            // Those beside surfaces are in the order of strata: evenly from all of them.
            let step = (free.len() / wanted as usize).max(1);
            free.into_iter().step_by(step).take(wanted as usize)
        };
        let mut numbers = Sequence::new(seed_of(&[42]));
        let places = free(inner).chain(free(beside)).flat_map(|position_m| {
            let direction = uniform_sphere(numbers.next_f32(), numbers.next_f32());
            [direction, -direction].map(|normal| {
                let site = Site { position_m, normal, face_normal: normal };
                Sampled { place: Place { site, number: None }, area_m2: 1.0 }
            })
        });
        Sample { places: places.collect(), ..Sample::default() }
    }

    fn chunk_of(&self, _: &Place) -> Option<usize> {
        None
    }

    fn trace(&mut self, sample: &[Place], _: usize, _: &Progress) -> Result<(), Cancelled> {
        self.points_m = points_of(sample).collect();
        Ok(())
    }

    fn relit<'a>(
        &'a self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Box<dyn Relit + 'a>, Cancelled> {
        let (field, geometry) = (self.light.field(), self.geometry());
        let (rows, bounces) = self.light.rows(reference, lighting, progress)?;
        let capture = Capture::new(geometry, &self.emitters, reference, lighting.emitter_scale);
        let truth = Truth::of(&capture, (field, geometry), &self.points_m, progress)?;
        Ok(Box::new(RelitSpace { field, geometry, rows, truth, bounces }))
    }

    fn notes(&self, sample: &[Place]) -> Vec<String> {
        vec![Agreement::at(self.light.field(), self.geometry(), points_of(sample)).words()]
    }
}

/// Points of a sample: two places are one.
fn points_of(sample: &[Place]) -> impl Iterator<Item = Vec3> + '_ {
    sample.iter().step_by(2).map(|place| place.site.position_m)
}

/// No surface is near a place, and no more than a quarter of what is seen from it are backs.
fn is_free(geometry: &Geometry, point_m: Vec3) -> bool {
    let mut backs = 0;
    let is_clear = (0..LOOK_RAYS).all(|ray| {
        let direction = relight_direction(ray, LOOK_RAYS);
        let hit = geometry.tracer.closest(point_m, direction, f32::INFINITY);
        backs += u32::from(hit.is_some_and(|hit| geometry.is_back(&hit)));
        hit.is_none_or(|hit| hit.t > CLEARANCE_M)
    });
    is_clear && 4 * backs <= LOOK_RAYS
}

/// Free space under some lights.
struct RelitSpace<'a> {
    field: &'a FieldTable,
    geometry: &'a Geometry,
    /// Coefficients at probes.
    rows: Vec<Vec4>,
    truth: Truth,
    bounces: (usize, bool),
}

impl Relit for RelitSpace<'_> {
    fn irradiance(&self, place: &Place) -> Option<DVec3> {
        let Site { position_m, normal, .. } = place.site;
        Some(self.field.irradiance(&self.rows, position_m, normal).as_dvec3())
    }

    fn bounces(&self) -> (usize, bool) {
        self.bounces
    }

    fn classes(&self, sample: &[Place]) -> Vec<ErrorClass> {
        let read = |reading: Reading, rows: &[Vec4]| -> Vec<DVec3> {
            let light = |place: &Place| {
                let Site { position_m, normal, .. } = place.site;
                reading.irradiance((self.field, rows), self.geometry, position_m, normal).as_dvec3()
            };
            sample.par_iter().map(light).collect()
        };
        let own = sample.iter().enumerate().map(|(index, place)| {
            let coefficients = self.truth.own.get(index / 2).copied().unwrap_or_default();
            irradiance(&coefficients, place.site.normal).as_dvec3()
        });
        let between = read(Reading::Exact, &self.truth.rows);
        let [exact, others @ ..] = Reading::ALL.map(|reading| read(reading, &self.rows));
        let shown = |place: &Place| self.irradiance(place).unwrap_or_default();
        let shown: Vec<DVec3> = sample.par_iter().map(shown).collect();
        let causes = [
            ("by nine harmonics at the place itself, by paths", Measure::AtSample(own.collect())),
            ("and between probes that rays see, with paths' light", Measure::AtSample(between.clone())),
            (
                "of the light that probes hold: rows, factors, numbers, fit",
                Measure::Rms(rms(&exact, &between)),
            ),
            ("of depth maps beside rays", Measure::Rms(rms(&shown, &exact))),
        ];
        let readings = std::iter::once(exact).chain(others).zip(Reading::ALL);
        let readings = readings.map(|(light, reading)| (reading.about(), Measure::AtSample(light)));
        let all = causes.into_iter().chain(readings).zip(CLASSES);
        all.map(|((about, measure), name)| ErrorClass { name, about, measure }).collect()
    }
}

/// Irradiance by a normal, of coefficients.
fn irradiance(coefficients: &[Vec4; PROBE_ROWS], normal: Vec3) -> Vec3 {
    let mut harmonics = [0.0; PROBE_ROWS];
    ShBasis::new(2).evaluate(normal, &mut harmonics);
    let sum: Vec4 = coefficients.iter().zip(harmonics).map(|(row, harmonic)| *row * harmonic).sum();
    sum.truncate().max(Vec3::ZERO)
}

/// Root mean square of the difference of luminance.
fn rms(a: &[DVec3], b: &[DVec3]) -> f64 {
    let squares: f64 = a.iter().zip(b).map(|(a, b)| (luminance(*a) - luminance(*b)).powi(2)).sum();
    (squares / a.len().max(1) as f64).sqrt()
}
