//! Lights to measure with, chosen from the scene: deterministic, and none of them was known while baking.

use std::cmp::Reverse;

use glam::{UVec3, Vec3};
use lightkiln_proto::scene::{LightKind, SceneLight};
use lightkiln_proto::sh::relight_direction;
use rayon::prelude::*;

use super::sample::spread_sites;
use super::solid::{Look, is_free, look};
use crate::prt::World;
use crate::rays::sampling::{R2, seed_of};
use crate::reference::{Lighting, PanelLight, Site};

/// Rays among which a spot's aim is sought.
const AIM_RAYS: u32 = 512;
/// Places that a light may stand at, along the scene's longest side.
const LATTICE_STEPS: u32 = 12;
/// Free space around a place, as a share of the lattice's step.
const CLEARANCE: f32 = 0.25;
/// Share of rays from a place that may meet backs.
const BACK_SHARE_MAX: f32 = 0.02;
/// Suns tried.
const SUNS: u32 = 64;
/// Lowest sun tried, as the sine of its height.
const SUN_LOWEST: f32 = 0.2;
/// Sites that a sun is tried on, and rays that tell how open each is.
const TRIED_SITES: u32 = 2048;
const OPENNESS_RAYS: u32 = 32;
/// Share of a site's rays that meet backs beyond which it stands outside.
const OUTSIDE_BACK_SHARE: f32 = 0.25;
/// Share of its directions up to which a site sees the sky past something, and the share of sites beyond which the scene is
/// open anyway.
const PARTLY_MAX: f32 = 0.75;
const SEEING_MIN: f32 = 0.05;
/// A panel's half sides as shares of the free space around its centre; the largest that fits is taken.
const PANEL_SHARES: [f32; 4] = [0.5, 0.35, 0.2, 0.1];

/// Some light under which a bake is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct TestLight {
    /// Short name, unique in an evaluation.
    pub name: String,
    /// What it is and where, for people.
    pub words: String,
    /// The light.
    pub lighting: Lighting,
}

/// What was chosen, and what was not and why.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Chosen {
    /// Lights in a fixed order.
    pub lights: Vec<TestLight>,
    /// Kinds left out, in words.
    pub notes: Vec<String>,
}

/// How the scene's surfaces see the sky. Like all that lights are chosen by, it does not hang on the bake that is measured,
/// so that figures of several can be held against each other.
pub(super) struct Openness {
    sites: Vec<Site>,
    /// Share of each site's directions that leave the scene.
    open: Vec<f32>,
}

impl Openness {
    /// Looks out from sites spread over the scene.
    pub fn of(world: &World) -> Self {
        let sites = spread_sites(world, TRIED_SITES);
        let offset_m = world.geometry.tracer.ray_offset_m();
        // A site that mostly sees backs of single-sided surfaces stands outside: on a rim of a wall that sticks out.
        let open_of = |site: &Site| {
            let points = R2::new(seed_of(&site.identity()));
            let (mut escaped, mut backs) = (0, 0);
            for ray in 0..OPENNESS_RAYS {
                let direction = site.direction(points.point(ray));
                let origin_m = site.ray_origin_m(offset_m);
                match world.geometry.tracer.closest(origin_m, direction, f32::INFINITY) {
                    None => escaped += 1,
                    Some(hit) => backs += u32::from(world.is_back(&hit)),
                }
            }
            let share = |count: u32| count as f32 / OPENNESS_RAYS as f32;
            (share(backs) <= OUTSIDE_BACK_SHARE).then(|| share(escaped))
        };
        let looked: Vec<Option<f32>> = sites.par_iter().map(open_of).collect();
        let (sites, open) =
            sites.into_iter().zip(looked).filter_map(|(site, open)| Some((site, open?))).unzip();
        Self { sites, open }
    }

    /// Sky comes in: some site sees it past something, or a good share of them at all. A rim that sticks out of a closed
    /// room is no opening.
    pub fn has_opening(&self) -> bool {
        let partly = |open: &f32| *open > 0.0 && *open <= PARTLY_MAX;
        let seeing = self.open.iter().filter(|open| **open > 0.0).count();
        self.open.iter().any(partly) || seeing as f32 > SEEING_MIN * self.open.len() as f32
    }

    /// How much a sun lights places that see little sky, and how many it lights: `Σ cosθ · (1 − openness)⁸`, so that it shines
    /// on a room's floor rather than on the reveals of its windows.
    fn lit_by(&self, world: &World, travel: Vec3) -> (f32, usize) {
        let far_m = extent_m(world) * 2.0 + 1.0;
        let offset_m = world.geometry.tracer.ray_offset_m();
        let (mut sum, mut count) = (0.0, 0);
        for (site, open) in self.sites.iter().zip(&self.open) {
            let cosine = site.lamp_cosine(-travel) as f32;
            let origin_m = site.ray_origin_m(offset_m);
            if cosine > 0.0 && !world.geometry.tracer.is_occluded(origin_m, origin_m - travel * far_m) {
                sum += cosine * (1.0 - open).powi(8);
                count += 1;
            }
        }
        (sum, count)
    }
}

/// A place and what is seen from there.
struct Standpoint {
    position_m: Vec3,
    look: Look,
}

/// Chooses the lights of a scene.
pub fn default_lights(world: &World) -> Chosen {
    let openness = Openness::of(world);
    let mut chosen = Chosen::default();
    let places = standpoints(world);
    if places.is_empty() {
        chosen.notes.push("no point, spot or panel: no place in free space was found".into());
    }
    chosen.lights.extend(point(&places));
    chosen.lights.extend(spot(world, &places));
    chosen.lights.extend(panel(world, &places));
    if openness.has_opening() {
        match sun(world, &openness) {
            Some(light) => chosen.lights.push(light),
            None => chosen.notes.push("no sun: no direction tried reaches a surface".into()),
        }
        chosen.lights.extend([
            sky("sky-uniform", [1.0; 3], [1.0; 3]),
            sky("sky-gradient", [0.4, 0.8, 2.0], [1.0, 0.8, 0.6]),
        ]);
    } else {
        chosen.notes.push("no sun and no sky: the scene has no opening".into());
    }
    if world.scene.materials.iter().any(|material| material.emissive != [0.0; 3]) {
        let lighting = Lighting { emitter_scale: 1.0, ..Lighting::default() };
        let words = "the scene's own emissive surfaces".to_owned();
        chosen.lights.push(TestLight { name: "emitters".into(), words, lighting });
    }
    chosen
}

/// Diagonal of the scene's bounds.
fn extent_m(world: &World) -> f32 {
    let [low, high] = bounds_m(world);
    (high - low).length()
}

/// Places of a lattice over the scene's bounds that meet no backs and touch nothing, widest view first. Rays that leave
/// the scene see nothing: places inside come before those outside. Of the scene alone, so that all its bakes are measured
/// under the same lights.
fn standpoints(world: &World) -> Vec<Standpoint> {
    let [low, high] = bounds_m(world);
    let step_m = ((high - low).max_element() / LATTICE_STEPS as f32).max(f32::MIN_POSITIVE);
    let counts = ((high - low) / step_m).floor().as_uvec3().min(UVec3::splat(LATTICE_STEPS - 1)) + 1;
    let place = |index: u32| {
        let cell = UVec3::new(index % counts.x, index / counts.x % counts.y, index / (counts.x * counts.y));
        let share = (cell.as_vec3() + 0.5) / counts.as_vec3();
        let position_m = low + (high - low) * share;
        let look = look(world, position_m);
        let stands = look.back_share <= BACK_SHARE_MAX && look.nearest_m >= CLEARANCE * step_m;
        stands.then_some(Standpoint { position_m, look })
    };
    let mut places: Vec<Standpoint> =
        (0..counts.element_product()).into_par_iter().filter_map(place).collect();
    places.sort_by(|a, b| b.look.mean_m.total_cmp(&a.look.mean_m));
    places
}

/// Bounds of the scene's surfaces.
fn bounds_m(world: &World) -> [Vec3; 2] {
    let positions = || world.scene.instances.iter().flat_map(|instance| &instance.positions_m);
    let low = positions().fold(Vec3::INFINITY, |low, position| low.min(*position));
    let high = positions().fold(Vec3::NEG_INFINITY, |high, position| high.max(*position));
    [low, high.max(low)]
}

fn words(at: Vec3) -> String {
    format!("{:.2},{:.2},{:.2}", at.x, at.y, at.z)
}

fn single(name: &str, words: String, kind: LightKind, strength: f32) -> TestLight {
    let light = SceneLight { name: name.to_owned(), kind, strength: [strength; 3] };
    TestLight {
        name: name.to_owned(),
        words,
        lighting: Lighting { lights: vec![light], ..Lighting::default() },
    }
}

/// At the place with the widest view.
fn point(places: &[Standpoint]) -> Option<TestLight> {
    let place = places.first()?;
    let kind = LightKind::Point { position_m: place.position_m.to_array(), range_m: None };
    let intensity = 10.0 * place.look.mean_m * place.look.mean_m;
    Some(single(
        "point",
        format!("a point at {}, where the view is widest", words(place.position_m)),
        kind,
        intensity,
    ))
}

/// From the widest view that is away from the point's, at the wall that is met most squarely.
fn spot(world: &World, places: &[Standpoint]) -> Option<TestLight> {
    let first = places.first()?.position_m;
    let apart_m = 0.15 * extent_m(world);
    let place = places.iter().find(|place| place.position_m.distance(first) > apart_m).or(places.first())?;
    let (from_m, view_m) = (place.position_m, place.look.mean_m);
    let squareness = |ray: u32| {
        let direction = relight_direction(ray, AIM_RAYS);
        let hit = world.geometry.tracer.closest(from_m, direction, f32::INFINITY)?;
        let normal = world.side_normal(&hit);
        let lit = !world.is_back(&hit);
        let is_wall = normal.y.abs() < 0.5 && hit.t > 0.5 * view_m && hit.t < 2.0 * view_m;
        (lit && is_wall).then(|| (-direction.dot(normal), Reverse(ray), direction, hit))
    };
    let aim = (0..AIM_RAYS).filter_map(squareness).max_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))?;
    let (_, _, direction, hit) = aim;
    let instance = world.geometry.triangles[hit.triangle as usize].instance;
    let kind = LightKind::Spot {
        position_m: from_m.to_array(),
        direction: direction.to_array(),
        inner_rad: 15.0_f32.to_radians(),
        outer_rad: 25.0_f32.to_radians(),
        range_m: None,
    };
    let said =
        format!("a spot at {} aimed at '{}'", words(from_m), world.scene.instances[instance as usize].path);
    Some(single("spot", said, kind, 100.0 * view_m * view_m))
}

/// A square that shines downwards, where the most free space is.
fn panel(world: &World, places: &[Standpoint]) -> Option<TestLight> {
    let mut roomiest: Vec<&Standpoint> = places.iter().collect();
    roomiest.sort_by(|a, b| b.look.nearest_m.total_cmp(&a.look.nearest_m));
    for place in roomiest.into_iter().take(16) {
        for share in PANEL_SHARES {
            let half_m = share * place.look.nearest_m.min(0.2 * extent_m(world));
            let panel = PanelLight {
                name: "panel".into(),
                centre_m: place.position_m.to_array(),
                half_u_m: [half_m, 0.0, 0.0],
                half_v_m: [0.0, 0.0, half_m],
                radiance: [10.0; 3],
            };
            if is_free(world, &panel) {
                let words = format!(
                    "a panel of {:.2} m at {} that shines down",
                    2.0 * half_m,
                    words(place.position_m)
                );
                let lighting = Lighting { panels: vec![panel], ..Lighting::default() };
                return Some(TestLight { name: "panel".into(), words, lighting });
            }
        }
    }
    None
}

/// The sun that lights the places that see least sky most.
fn sun(world: &World, openness: &Openness) -> Option<TestLight> {
    let suns: Vec<Vec3> = (0..SUNS)
        .map(|ray| relight_direction(ray, SUNS))
        .filter(|to| to.y >= SUN_LOWEST)
        .map(|to| -to)
        .collect();
    let scored: Vec<(f32, usize)> = suns.par_iter().map(|travel| openness.lit_by(world, *travel)).collect();
    let (travel, (score, _)) = suns
        .iter()
        .zip(scored)
        .max_by(|a, b| a.1.0.total_cmp(&b.1.0))
        .filter(|(_, (_, count))| *count > 0)?;
    let kind = LightKind::Sun { direction: travel.to_array() };
    let way = if score > 0.0 { "into the scene through its openings" } else { "from outside" };
    Some(single("sun", format!("a sun that travels along {}, {way}", words(*travel)), kind, 10.0))
}

fn sky(name: &str, zenith: [f32; 3], horizon: [f32; 3]) -> TestLight {
    let kind = LightKind::Sky { zenith, horizon };
    single(name, format!("a sky of {zenith:?} at the zenith and {horizon:?} at the horizon"), kind, 1.0)
}
