//! A scene with light captured at probes, and ways to read it.

use anyhow::Result;
use glam::{Vec3, Vec4};
use lightkiln_proto::kinds::captured;
use lightkiln_proto::kinds::field::FieldTable;
use lightkiln_worker::geometry::{Geometry, Site};
pub use lightkiln_worker::kinds::field::Reading;
use lightkiln_worker::reference::{Lighting, Precision, Reference, luminance};
use lightkiln_worker::scene::{Bundle, Limits, import};
use lightkiln_worker::task::Progress;
use serde_json::{Map, Value};

use crate::harness::{self, LocalBake, Recipe, bake, free_points};

/// The scene and its bake.
pub struct CapturedScene {
    /// The scene.
    pub geometry: Geometry,
    /// The bake.
    pub bake: LocalBake,
    /// Probes.
    pub field: FieldTable,
    /// Coefficients at them.
    pub rows: Vec<Vec4>,
}

impl CapturedScene {
    /// Bakes a scene with some settings beside those of a draft.
    pub fn new(bundle: &[u8], settings: &[(&str, f64)]) -> Result<Self> {
        let mut all = Map::from_iter([("preset".to_owned(), Value::from("draft"))]);
        for &(name, value) in settings {
            let whole = value.fract() == 0.0 && name != "field_spacing_m";
            all.insert(name.to_owned(), if whole { (value as u64).into() } else { value.into() });
        }
        let recipe = Recipe { kind: captured::NAME, settings: Value::Object(all) };
        let bake = bake(bundle.to_vec(), &recipe)?;
        let (field, rows) = harness::captured(&bake)?;
        let limits = Limits::default();
        let scene = import(&Bundle::from_bytes(bundle.to_vec(), &limits)?, &limits)?.scene;
        Ok(Self { geometry: Geometry::new(scene)?, bake, field, rows })
    }

    /// Places of probes in metres.
    pub fn places_m(&self) -> impl Iterator<Item = Vec3> + '_ {
        self.field.position_m.iter().map(|place_m| place_m.truncate())
    }

    /// Light of a normal at a point, by depth maps.
    pub fn light(&self, point_m: Vec3, normal: Vec3) -> f64 {
        luminance(self.field.irradiance(&self.rows, point_m, normal).as_dvec3())
    }

    /// Likewise, read another way.
    pub fn read(&self, reading: Reading, point_m: Vec3, normal: Vec3) -> f64 {
        let light = reading.irradiance((&self.field, &self.rows), &self.geometry, point_m, normal);
        luminance(light.as_dvec3())
    }

    /// Bounced light of sites by paths.
    pub fn traced(&self, sites: &[Site]) -> Result<Vec<f64>> {
        let lights = self.geometry.scene.lights.clone();
        let lighting = Lighting { lights, emitter_scale: 1.0, ..Lighting::default() };
        let reference = Reference::new(&self.geometry, &lighting)?;
        let precision = Precision { rel_error: 0.03, paths_max: 1 << 13 };
        let found = reference.irradiance(sites, &precision, &Progress::new())?;
        Ok(found.iter().map(|estimate| estimate.indirect.luminance()).collect())
    }

    /// So many free points of a box, 2 cm off surfaces at least.
    pub fn free_points(&self, box_m: [Vec3; 2], count: usize) -> Result<Vec<Vec3>> {
        free_points(&self.geometry, box_m, 0.02, count)
    }

    /// Counts of the placement.
    pub fn counts(&self) -> Result<std::collections::BTreeMap<String, u64>> {
        Ok(self.bake.manifest.body::<captured::Body>()?.field.placement)
    }

    /// Seconds of a task kind.
    pub fn seconds(&self, kind: &str) -> f64 {
        self.bake.secs.get(kind).copied().unwrap_or_default()
    }
}

/// The mean of some light over points, with six normals each.
pub fn mean(points_m: &[Vec3], light: impl Fn(Vec3, Vec3) -> f64) -> f64 {
    let normals = [Vec3::X, Vec3::Y, Vec3::Z].into_iter().flat_map(|axis| [axis, -axis]);
    let all = normals.flat_map(|normal| points_m.iter().map(move |&point_m| (point_m, normal)));
    all.map(|(point_m, normal)| light(point_m, normal)).sum::<f64>() / (6 * points_m.len()).max(1) as f64
}

/// The root mean square of differences over the mean of what is wanted.
pub fn error(found: &[f64], wanted: &[f64]) -> f64 {
    let count = wanted.len().max(1) as f64;
    let squares: f64 = found.iter().zip(wanted).map(|(found, wanted)| (found - wanted).powi(2)).sum();
    (squares / count).sqrt() / (wanted.iter().sum::<f64>() / count).max(f64::MIN_POSITIVE)
}
