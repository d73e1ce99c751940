//! Step "test": each candidate looks round, and is shifted out of geometry (\[Sedlacek2019\] §5.1.4) or found invalid.

use glam::Vec3;
use lightkiln_proto::settings::PlaceSettings;

use crate::geometry::Geometry;
use crate::lightmap::{Receiver, link_height_m};
use crate::rays::sampling::{R2, seed_of, uniform_hemisphere};
use crate::task::Progress;

/// Test rays per receiver.
pub const TEST_RAYS: u32 = 32;
/// Most texels that a ray counts in [`Look::seen`].
const SEEN_MAX: f32 = 16.0;
/// Width in texels of a surface's rim, where a point may be beyond the wall that meets it there by rounding alone.
const RIM_WIDTH: f32 = 1.0 / 128.0;
/// Share of the rays that exceed [`Look::far`].
const FAR_SHARE: f32 = 0.25;
/// Farthest shift in texels. We differ: the source shifts any distance, which moves texels deep inside a solid to
/// places that they have nothing to do with; such texels are never seen and are left out.
const SHIFT_MAX_TEXELS: f32 = 1.5;

/// Tests receivers against the scene's back faces.
pub struct Tester<'a> {
    geometry: &'a Geometry,
    back_face_min: f32,
    texel_m: f32,
    progress: &'a Progress,
}

/// A receiver at a point where it can be.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The receiver, shifted if need be.
    pub receiver: Receiver,
    /// Mean free path above it in texels, each ray counted up to one and by its cosine.
    pub openness: f32,
    /// Share of its rays that meet back faces of single-sided surfaces.
    pub back_share: f32,
    /// Mean free path above it in texels, weighted by the rays' cosine; infinite where one leaves the scene.
    pub outlook: f32,
    /// As [`Look::far`].
    pub far: f32,
    /// As [`Look::away`].
    pub away: f32,
    /// It was shifted off its surface.
    pub is_shifted: bool,
    /// It was shifted off its surface, out through the top of a thing that lies on that, not beside it.
    pub is_lifted: bool,
}

/// Surroundings of a point by its test rays.
#[derive(Clone, Copy, Debug, Default)]
pub struct Look {
    /// As [`Candidate::openness`].
    pub openness: f32,
    /// As [`Candidate::outlook`].
    pub outlook: f32,
    /// Room that it sees, and so is seen from: the mean cube of paths in texels, weighted by the rays' cosine, each ray counted up
    /// to 16 texels.
    pub seen: f32,
    /// As [`Candidate::outlook`], of the rays that meet something: an opening does not make a hollow endless. 0 without any.
    pub room: f32,
    /// Length in texels that a quarter of the rays exceed, each by its cosine; infinite where so many leave the scene. A crack
    /// between two faces lets one or two out.
    pub far: f32,
    /// Share of the surfaces in sight, by the rays' cosine, that are turned away, be they double-sided or not: those of a hollow
    /// thing are, those of a room are not.
    pub away: f32,
    /// As [`Candidate::back_share`].
    pub back_share: f32,
    /// Share of the rays that leave the scene, each by its cosine; of all rays together about 1.
    pub sky: f32,
    /// Direction and distance of the nearest back face.
    pub nearest: Option<(Vec3, f32)>,
}

impl Candidate {
    fn of(receiver: Receiver, look: &Look) -> Self {
        let &Look { openness, back_share, outlook, far, away, .. } = look;
        Self { receiver, openness, back_share, outlook, far, away, is_shifted: false, is_lifted: false }
    }
}

impl<'a> Tester<'a> {
    /// A tester for texels of `texel_m` metres.
    pub fn new(
        geometry: &'a Geometry,
        settings: &PlaceSettings,
        texel_m: f32,
        progress: &'a Progress,
    ) -> Self {
        let back_face_min = settings.shift_back_face_min;
        Self { geometry, back_face_min, texel_m, progress }
    }

    /// Whether somebody still waits.
    pub fn progress(&self) -> &Progress {
        self.progress
    }

    /// The receiver where it can be: as it is, shifted through the nearest back face when at least the set share
    /// of test rays meets back faces and none escapes, or `None` when it is inside geometry for good.
    pub fn candidate(&self, receiver: Receiver, block_key: u64) -> Option<Candidate> {
        let [x, y] = receiver.texel.map(u64::from);
        let seed = seed_of(&[block_key, x, y, 1]);
        let offset_m = self.geometry.tracer.ray_offset_m(receiver.position_m);
        let start_m = receiver.position_m + receiver.face_normal * offset_m;
        let found = self.look(start_m, receiver.face_normal, seed);
        if found.back_share < self.back_face_min || found.sky > 0.0 {
            return Some(Candidate::of(receiver, &found));
        }
        let (direction, distance_m) = found.nearest?;
        if distance_m > self.texel_m * SHIFT_MAX_TEXELS {
            return None;
        }
        let moved_m = start_m + direction * (distance_m + 8.0 * offset_m);
        let moved = self.look(moved_m, receiver.face_normal, seed);
        let receiver = Receiver { position_m: moved_m, ..receiver };
        let is_lifted = direction.dot(receiver.face_normal) > 0.5;
        let shifted = Candidate { is_shifted: true, is_lifted, ..Candidate::of(receiver, &moved) };
        (moved.back_share < self.back_face_min).then_some(shifted)
    }

    /// A wall stands between two receivers, both raised as for their links.
    pub fn is_parted(&self, a: &Receiver, b: &Receiver) -> bool {
        let height_m = link_height_m(self.texel_m);
        let [a_m, b_m] = [a, b].map(|r| self.geometry.raised(r.position_m, r.face_normal, height_m));
        self.geometry.tracer.is_occluded(a_m, b_m)
    }

    /// A wall stands between two receivers, and also where the first is a little nearer to the second.
    pub fn is_beyond(&self, a: &Receiver, b: &Receiver) -> bool {
        let nearer_m = (b.position_m - a.position_m).clamp_length_max(RIM_WIDTH * self.texel_m);
        let nearer = Receiver { position_m: a.position_m + nearer_m, ..*a };
        self.is_parted(a, b) && self.is_parted(&nearer, b)
    }

    fn look(&self, start_m: Vec3, normal: Vec3, seed: u64) -> Look {
        look(self.geometry, self.texel_m, (start_m, normal), seed)
    }
}

/// Surroundings of a point above a surface with that normal, in texels of `texel_m` metres. Casts [`TEST_RAYS`].
pub fn look(geometry: &Geometry, texel_m: f32, (start_m, normal): (Vec3, Vec3), seed: u64) -> Look {
    let points = R2::new(seed);
    let mut found = Look::default();
    let (mut back, mut free, mut path, mut weight) = (0, 0.0, 0.0, 0.0);
    let (mut seen, mut away) = (0.0, 0.0);
    let mut paths = [(f32::INFINITY, 0.0); TEST_RAYS as usize];
    for ray in 0..TEST_RAYS {
        let (direction, cosine) = uniform_hemisphere(normal, points.point(ray));
        let hit = geometry.tracer.closest(start_m, direction, f32::INFINITY);
        paths[ray as usize] = (hit.map_or(f32::INFINITY, |hit| hit.t / texel_m), cosine);
        let Some(hit) = hit else {
            found.sky += 2.0 * cosine;
            free += 2.0 * cosine;
            seen += SEEN_MAX.powi(3) * cosine;
            continue;
        };
        seen += (hit.t / texel_m).min(SEEN_MAX).powi(3) * cosine;
        path += hit.t / texel_m * cosine;
        weight += cosine;
        away += if hit.front { 0.0 } else { cosine };
        free += (hit.t / texel_m).min(1.0) * 2.0 * cosine;
        if !geometry.is_back(&hit) {
            continue;
        }
        back += 1;
        if found.nearest.is_none_or(|(_, nearest)| hit.t < nearest) {
            found.nearest = Some((direction, hit.t));
        }
    }
    paths.sort_by(|a, b| b.0.total_cmp(&a.0));
    let quarter = FAR_SHARE * paths.iter().map(|(_, weight)| weight).sum::<f32>();
    let mut longer = 0.0;
    let is_far = |&&(_, weight): &&(f32, f32)| {
        longer += weight;
        longer >= quarter
    };
    found.far = paths.iter().find(is_far).map_or(0.0, |(length, _)| *length);
    found.openness = free / TEST_RAYS as f32;
    found.seen = 2.0 * seen / TEST_RAYS as f32;
    found.sky /= TEST_RAYS as f32;
    found.room = path / weight.max(f32::MIN_POSITIVE);
    found.away = away / weight.max(f32::MIN_POSITIVE);
    found.outlook = if found.sky > 0.0 { f32::INFINITY } else { found.room };
    found.back_share = back as f32 / TEST_RAYS as f32;
    found
}
