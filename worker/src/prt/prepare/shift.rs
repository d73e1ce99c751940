//! Shifts receivers out of geometry ([Sedlacek2019] §5.1.4), or finds them invalid.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use lightkiln_proto::prt::Settings;

use crate::prt::stage::Receiver;
use crate::prt::world::{Geometry, link_height_m};
use crate::rays::sampling::{R2, seed_of, tangent_frame, uniform_sphere};
use crate::scene::model::Scene;

/// Test rays per receiver.
const TEST_RAYS: u32 = 32;
/// Farthest shift in texels. We differ: the source shifts any distance, which moves texels deep inside a solid to
/// places that they have nothing to do with; such texels are never seen and are left out.
const SHIFT_MAX_TEXELS: f32 = 1.5;

/// Tests receivers against the scene's back faces.
pub struct Shifter<'a> {
    scene: &'a Scene,
    geometry: &'a Geometry,
    back_face_min: f32,
    texel_m: f32,
    rays: AtomicU64,
}

/// A receiver where it can stand.
#[derive(Clone, Copy, Debug)]
pub struct Standing {
    /// The receiver.
    pub receiver: Receiver,
    /// Mean free path above it in texels, each ray counted up to one and by its cosine.
    pub openness: f32,
    /// Share of its rays that meet back faces of single-sided surfaces.
    pub back_share: f32,
    /// It was moved off its surface.
    pub is_moved: bool,
    /// It was moved off its surface, out through the top of what lies on that, not beside it.
    pub is_lifted: bool,
}

/// What the test rays of a receiver met.
struct Probing {
    openness: f32,
    back_share: f32,
    escaped: bool,
    /// Direction and distance of the nearest back face.
    nearest: Option<(Vec3, f32)>,
}

impl<'a> Shifter<'a> {
    /// A shifter for texels of `texel_m` metres.
    pub fn new(scene: &'a Scene, geometry: &'a Geometry, settings: &Settings, texel_m: f32) -> Self {
        Self {
            scene,
            geometry,
            back_face_min: settings.shift_back_face_min,
            texel_m,
            rays: AtomicU64::new(0),
        }
    }

    /// The receiver where it can stand: as it is, shifted through the nearest back face when at least the set share
    /// of test rays meets back faces and none escapes, or `None` when it is inside geometry for good.
    pub fn shifted(&self, receiver: Receiver, block_key: u64) -> Option<Standing> {
        let [x, y] = receiver.texel.map(u64::from);
        let seed = seed_of(&[block_key, x, y, 1]);
        let offset_m = self.geometry.tracer.ray_offset_m();
        let start_m = receiver.position_m + receiver.face_normal * offset_m;
        let found = self.probe(start_m, receiver.face_normal, seed);
        if found.back_share < self.back_face_min || found.escaped {
            let Probing { openness, back_share, .. } = found;
            return Some(Standing { receiver, openness, back_share, is_moved: false, is_lifted: false });
        }
        let (direction, distance_m) = found.nearest?;
        if distance_m > self.texel_m * SHIFT_MAX_TEXELS {
            return None;
        }
        let moved_m = start_m + direction * (distance_m + 8.0 * offset_m);
        let moved = self.probe(moved_m, receiver.face_normal, seed);
        let receiver = Receiver { position_m: moved_m, ..receiver };
        let is_lifted = direction.dot(receiver.face_normal) > 0.5;
        let Probing { openness, back_share, .. } = moved;
        let standing = Standing { receiver, openness, back_share, is_moved: true, is_lifted };
        (moved.back_share < self.back_face_min).then_some(standing)
    }

    /// A wall stands between two receivers, both raised as for their links.
    pub fn is_parted(&self, a: &Receiver, b: &Receiver) -> bool {
        let height_m = link_height_m(self.texel_m);
        let [a_m, b_m] = [a, b].map(|r| self.geometry.raised(r.position_m, r.face_normal, height_m));
        self.rays.fetch_add(2, Ordering::Relaxed);
        self.geometry.tracer.is_occluded(a_m, b_m)
    }

    /// Closest-hit rays cast since the last call.
    pub fn take_rays(&self) -> u64 {
        self.rays.swap(0, Ordering::Relaxed)
    }

    fn probe(&self, start_m: Vec3, normal: Vec3, seed: u64) -> Probing {
        let (tangent, bitangent) = tangent_frame(normal);
        let points = R2::new(seed);
        let mut probing = Probing { openness: 0.0, back_share: 0.0, escaped: false, nearest: None };
        let (mut back, mut free) = (0, 0.0);
        for ray in 0..TEST_RAYS {
            let [u, v] = points.point(ray);
            let local = uniform_sphere(u * 0.5, v);
            let direction = tangent * local.x + bitangent * local.y + normal * local.z;
            let Some(hit) = self.geometry.tracer.closest(start_m, direction, f32::INFINITY) else {
                probing.escaped = true;
                free += 2.0 * local.z;
                continue;
            };
            free += (hit.t / self.texel_m).min(1.0) * 2.0 * local.z;
            let instance = self.geometry.triangles[hit.triangle as usize].instance;
            let material = self.scene.instances[instance as usize].material_index;
            if hit.front || self.scene.materials[material as usize].double_sided {
                continue;
            }
            back += 1;
            if probing.nearest.is_none_or(|(_, nearest)| hit.t < nearest) {
                probing.nearest = Some((direction, hit.t));
            }
        }
        self.rays.fetch_add(u64::from(TEST_RAYS), Ordering::Relaxed);
        probing.openness = free / TEST_RAYS as f32;
        probing.back_share = back as f32 / TEST_RAYS as f32;
        probing
    }
}
