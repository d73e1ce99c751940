//! Cones as bundles of walks: what a point receives, and how open it is.
//!
//! Each walk stands for 1/(M·pdf) of all directions, and is as wide as that part of the sphere: `τ = √(1/(π M pdf)) ≤ 1`.

use std::f32::consts::{FRAC_PI_4, PI};

use glam::Vec3;

use super::table::{VoxelTable, mixed};
use super::walk::{Start, WalkHit, walk, walk_within};

/// Walks for irradiance: 8 % of noise in a room with one bounce of hard light; a quarter of them have 20 %.
pub const IRRADIANCE_WALKS: u32 = 64;
/// Walks for what microfacets reflect.
pub const REFLECTION_WALKS: u32 = 16;
/// Walks for ambient occlusion.
pub const OCCLUSION_WALKS: u32 = 32;
/// Reach of ambient occlusion in metres.
pub const OCCLUSION_REACH_M: f32 = 1.0;
/// Least cosine between a normal and the eye for reflections; less is taken for it.
const EYE_MIN: f32 = 0.05;
/// Steps of the R₂ sequence \[Roberts2018\] in 2⁻³²: the plastic number's reciprocal and its square.
const R2_STEPS: [u32; 2] = [3_242_174_889, 2_447_445_413];

/// A direction of length 1, and the tangent of the half angle of the cone around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// Its axis ω.
    pub direction: Vec3,
    /// τ.
    pub tangent: f32,
}

/// The first M points of the R₂ sequence, shifted by an identity: directions of M walks. In whole numbers, alike on all machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bundle {
    walks: u32,
    shift: [u32; 2],
}

impl Bundle {
    /// Of so many walks from what has that identity, a receiver or a pixel.
    pub fn new(walks: u32, identity: u32) -> Self {
        let first = mixed(identity ^ 0x6b69_6c6e);
        Self { walks, shift: [first, mixed(first ^ 0x9e37_79b9)] }
    }

    /// How many walks there are.
    pub fn walks(&self) -> u32 {
        self.walks
    }

    /// Point of a walk in the unit square, 1 excluded.
    pub fn point(&self, index: u32) -> [f32; 2] {
        let turn = |axis: usize| self.shift[axis].wrapping_add(index.wrapping_mul(R2_STEPS[axis]));
        // 24 bits, as many as an f32 holds.
        [turn(0), turn(1)].map(|at| (at >> 8) as f32 * (1.0 / 16_777_216.0))
    }

    /// Cone of a walk, cosine-distributed about a normal: `pdf = cosθ/π` (concentric map, \[Shirley1997\]).
    pub fn cosine(&self, index: u32, normal: Vec3) -> Cone {
        let [a, b] = self.point(index).map(|at| 2.0 * at - 1.0);
        let (radius, angle) = if a.abs() > b.abs() {
            (a, FRAC_PI_4 * (b / a))
        } else if b != 0.0 {
            (b, 2.0 * FRAC_PI_4 - FRAC_PI_4 * (a / b))
        } else {
            (0.0, 0.0)
        };
        let (sine, cosine) = libm::sincosf(angle);
        let (x, y) = (radius * cosine, radius * sine);
        let z = (1.0 - x * x - y * y).max(0.0).sqrt();
        Cone { direction: turned(Vec3::new(x, y, z), normal), tangent: self.tangent(z / PI) }
    }

    /// Cone of a walk that a microfacet reflects from the eye, drawn among those that the eye sees (\[Dupuy2023\]): with slopes of width α,
    /// `pdf = D/(2(c + √(α² + (1−α²)c²)))`, c the cosine between normal and eye.
    pub fn reflected(&self, index: u32, normal: Vec3, eye: Vec3, alpha: f32) -> Cone {
        let [u, v] = self.point(index);
        let (x, y) = basis_about(normal);
        let cosine = normal.dot(eye).max(EYE_MIN);
        let seen = Vec3::new(x.dot(eye), y.dot(eye), cosine).normalize();
        let stretched = Vec3::new(alpha * seen.x, alpha * seen.y, seen.z).normalize();
        let (sine, turn) = libm::sincosf(u * 2.0 * PI);
        let up = (1.0 - v) * (1.0 + stretched.z) - stretched.z;
        let radius = (1.0 - up * up).max(0.0).sqrt();
        let half = Vec3::new(radius * turn, radius * sine, up) + stretched;
        let facet = Vec3::new(alpha * half.x, alpha * half.y, half.z.max(0.0)).normalize_or(Vec3::Z);
        let local = facet * (2.0 * facet.dot(seen)) - seen;
        let a2 = alpha * alpha;
        // 1 − (1 − α²) z², as the difference has too few digits at the peak of narrow lobes.
        let spread = facet.x * facet.x + facet.y * facet.y + a2 * facet.z * facet.z;
        let slopes = a2 / (PI * spread * spread);
        let pdf = slopes / (2.0 * (seen.z + (a2 + (1.0 - a2) * seen.z * seen.z).sqrt()));
        let direction = x * local.x + y * local.y + normal * local.z;
        Cone { direction, tangent: self.tangent(pdf) }
    }

    /// Cone of a walk, uniform in a cone about an axis: `pdf = 1/(4π sin²(α/2))`, α its half angle, up to π.
    pub fn uniform(&self, index: u32, axis: Vec3, half_angle_rad: f32) -> Cone {
        let [u, v] = self.point(index);
        let half_sine = libm::sinf(0.5 * half_angle_rad);
        // 1 − z, as z itself has too few digits in narrow cones.
        let below = 2.0 * half_sine * half_sine * u;
        let (sine, cosine) = libm::sincosf(v * 2.0 * PI);
        let radius = (below * (2.0 - below)).max(0.0).sqrt();
        let direction = turned(Vec3::new(radius * cosine, radius * sine, 1.0 - below), axis);
        Cone { direction, tangent: self.tangent(1.0 / (4.0 * PI * half_sine * half_sine)) }
    }

    /// `τ = √(1/(π M pdf)) ≤ 1`.
    fn tangent(&self, pdf: f32) -> f32 {
        let share = PI * self.walks as f32 * pdf;
        if share > 1.0 { (1.0 / share).sqrt() } else { 1.0 }
    }
}

impl Cone {
    /// Mirrored above a face where it lies below.
    #[must_use]
    pub fn above(self, face_normal: Vec3) -> Self {
        let below = self.direction.dot(face_normal).min(0.0);
        Self { direction: self.direction - face_normal * (2.0 * below), ..self }
    }
}

/// The surface or the sky in a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Seen {
    /// An element.
    Hit(WalkHit),
    /// The sky there.
    Sky(Vec3),
}

/// Irradiance at a start on a surface of a shading normal in W·m⁻²: `E = π/M Σ L`, L the radiance in W·m⁻²·sr⁻¹ of what cosine-distributed walks see.
pub fn irradiance(
    table: &VoxelTable,
    start: &Start,
    normal: Vec3,
    bundle: &Bundle,
    radiance: impl Fn(&Seen) -> Vec3,
) -> Vec3 {
    let seen = |index| {
        let Cone { direction, tangent } = bundle.cosine(index, normal).above(start.normal.unwrap_or(normal));
        radiance(&walk(table, start, direction, tangent).map_or(Seen::Sky(direction), Seen::Hit))
    };
    (0..bundle.walks).map(seen).sum::<Vec3>() * (PI / bundle.walks as f32)
}

/// Mean radiance in W·m⁻²·sr⁻¹ of what microfacets with slopes of width α, about a shading normal, reflect towards the eye from a start on a surface: times
/// their albedo it is the radiance that they send.
pub fn reflection(
    table: &VoxelTable,
    start: &Start,
    (normal, eye, alpha): (Vec3, Vec3, f32),
    bundle: &Bundle,
    radiance: impl Fn(&Seen) -> Vec3,
) -> Vec3 {
    let seen = |index| {
        let cone = bundle.reflected(index, normal, eye, alpha).above(start.normal.unwrap_or(normal));
        let hit = walk(table, start, cone.direction, cone.tangent);
        radiance(&hit.map_or(Seen::Sky(cone.direction), Seen::Hit))
    };
    (0..bundle.walks).map(seen).sum::<Vec3>() / bundle.walks as f32
}

/// Ambient occlusion at a start on a surface of a shading normal, 1 where nothing is near: `1 − 1/M Σ (1 − min(t/R, 1))²`, t the lengths of cosine-distributed
/// walks and R their reach in metres.
pub fn ambient_occlusion(
    table: &VoxelTable,
    start: &Start,
    normal: Vec3,
    bundle: &Bundle,
    reach_m: f32,
) -> f32 {
    let hidden = |index| {
        let Cone { direction, tangent } = bundle.cosine(index, normal).above(start.normal.unwrap_or(normal));
        let hit = walk_within(table, start, direction, tangent, reach_m);
        hit.map_or(0.0, |hit| (1.0 - hit.t_m / reach_m) * (1.0 - hit.t_m / reach_m))
    };
    1.0 - (0..bundle.walks).map(hidden).sum::<f32>() / bundle.walks as f32
}

/// A direction about +z, turned so that +z becomes an axis.
fn turned(local: Vec3, axis: Vec3) -> Vec3 {
    let (x, y) = basis_about(axis);
    x * local.x + y * local.y + axis * local.z
}

/// The axes across one (the frame of \[Duff2017\]).
fn basis_about(axis: Vec3) -> (Vec3, Vec3) {
    let sign = if axis.z < 0.0 { -1.0 } else { 1.0 };
    let a = -1.0 / (sign + axis.z);
    let b = axis.x * axis.y * a;
    let x = Vec3::new(1.0 + sign * axis.x * axis.x * a, sign * b, -sign * axis.x);
    (x, Vec3::new(b, sign + axis.y * axis.y * a, -axis.y))
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::super::shells::{Scene, box_shell, odd_turn, sheet, sphere_shell};
    use super::*;

    #[test]
    fn cosine_directions_have_the_moments_of_their_density() {
        let normal = Vec3::new(0.48, -0.6, -0.64);
        let bundle = Bundle::new(4096, 3);
        let cones: Vec<Cone> = (0..4096).map(|index| bundle.cosine(index, normal)).collect();
        let mean = cones.iter().map(|cone| cone.direction.dot(normal)).sum::<f32>() / 4096.0;
        // E[cosθ] = ∫ cosθ · cosθ/π dω = 2/3.
        assert!((mean - 2.0 / 3.0).abs() < 2e-3, "{mean}");
        for cone in &cones {
            let cosine = cone.direction.dot(normal);
            assert!((cone.direction.length() - 1.0).abs() < 1e-5 && cosine > -1e-5);
            // τ² = 1/(M cosθ).
            let wanted = (1.0 / (4096.0 * cosine.max(1e-9))).sqrt().min(1.0);
            assert!(cosine < 0.01 || (cone.tangent - wanted).abs() < 1e-3 * wanted);
            assert!(cone.tangent <= 1.0);
        }
    }

    #[test]
    fn uniform_directions_fill_their_cone_evenly() {
        let axis = Vec3::new(-0.6, 0.0, 0.8);
        for half_angle in [1e-3_f32, 0.05, 0.5, 1.5, PI] {
            let bundle = Bundle::new(1024, 9);
            let cones: Vec<Cone> = (0..1024).map(|index| bundle.uniform(index, axis, half_angle)).collect();
            let below = |cone: &Cone| 0.5 * (cone.direction - axis).length_squared();
            let most = 2.0 * (0.5 * half_angle).sin().powi(2);
            let mean = cones.iter().map(below).sum::<f32>() / 1024.0;
            assert!((mean / most - 0.5).abs() < 0.01, "{half_angle}: {mean}");
            assert!(cones.iter().all(|cone| below(cone) < 1.001 * most));
            // All walks' cones together are as wide as the cone: M τ² = 4 sin²(α/2).
            assert!((1024.0 * cones[0].tangent * cones[0].tangent / (2.0 * most) - 1.0).abs() < 1e-3);
        }
    }

    /// Directions have the density that widths are made of: the mean of any function over it is its integral over the hemisphere.
    #[test]
    fn reflected_directions_have_the_moments_of_their_density() {
        let normal = Vec3::new(0.48, -0.6, -0.64);
        let across = normal.any_orthonormal_vector();
        for (alpha, cosine) in [(0.1_f32, 0.9_f32), (0.3, 0.4), (0.7, 0.7), (1.0, 0.5)] {
            let eye = normal * cosine + across * (1.0 - cosine * cosine).sqrt();
            let bundle = Bundle::new(1 << 14, 5);
            let cones: Vec<Cone> =
                (0..1 << 14).map(|index| bundle.reflected(index, normal, eye, alpha)).collect();
            for cone in &cones {
                assert!((cone.direction.length() - 1.0).abs() < 1e-4 && cone.tangent <= 1.0, "{cone:?}");
            }
            // Σ 1/(M pdf) over directions in a part of the sphere is its solid angle: π τ² each.
            let lobe = normal * (2.0 * cosine) - eye;
            let half_angle = (2.0 * alpha).min(0.5);
            let within = cones.iter().filter(|cone| cone.direction.dot(lobe) > half_angle.cos());
            let solid = within.map(|cone| PI * cone.tangent * cone.tangent).sum::<f32>();
            let wanted = 2.0 * PI * (1.0 - half_angle.cos());
            assert!((solid / wanted - 1.0).abs() < 0.05, "{alpha} {cosine}: {solid}, not {wanted}");
        }
    }

    /// A mirror sees what is mirrored, a rough one its lobe; whatever surfaces of radiance 1 enclose is reflected with mean 1.
    #[test]
    fn reflection_of_an_even_room_is_one_and_a_mirror_sees_one_wall() {
        let floor = sheet(DVec3::new(0.0, -4.0, 0.0), DVec3::X * 4.0, DVec3::Y * 8.0, 0);
        let wall = sheet(DVec3::new(4.0, -4.0, 0.0), DVec3::Z * 4.0, DVec3::Y * 8.0, 1);
        let scene = Scene::new(0.1, 0..7, &[floor, wall].concat());
        let table = scene.table();
        let start = Start::on(Vec3::new(3.0, 0.02, 0.0), Vec3::Z);
        let bright = |seen: &Seen| match seen {
            Seen::Hit(hit) if scene.surface(hit.patch) == 1 => Vec3::ONE,
            _ => Vec3::ZERO,
        };
        let eye = Vec3::new(-0.6, 0.0, 0.8);
        let of =
            |eye, alpha| reflection(&table, &start, (Vec3::Z, eye, alpha), &Bundle::new(64, 2), bright).x;
        assert_eq!(of(eye, 0.01), 1.0);
        assert_eq!(of(Vec3::new(0.6, 0.0, 0.8), 0.01), 0.0);
        let rough = of(eye, 1.0);
        assert!(rough > 0.3 && rough < 0.9, "{rough}");
        let even = reflection(&table, &start, (Vec3::Z, eye, 0.5), &Bundle::new(64, 2), |_| Vec3::ONE);
        assert!((even - 1.0).abs().max_element() < 1e-5, "{even}");
    }

    #[test]
    fn identities_have_directions_of_their_own() {
        let first = |identity| Bundle::new(64, identity).cosine(0, Vec3::Z).direction;
        assert_eq!(first(1), first(1));
        assert!(first(1).distance(first(2)) > 1e-3 && first(0).distance(first(1)) > 1e-3);
        let all: Vec<[f32; 2]> = (0..4096).map(|identity| Bundle::new(64, identity).point(5)).collect();
        for axis in 0..2 {
            let mean = all.iter().map(|point| point[axis]).sum::<f32>() / 4096.0;
            assert!((mean - 0.5).abs() < 0.02 && all.iter().all(|point| point[axis] < 1.0), "{mean}");
        }
    }

    #[test]
    fn closed_room_of_radiance_one_gives_irradiance_pi_and_the_open_sky_too() {
        let scene = Scene::new(0.05, 0..6, &box_shell(DVec3::new(0.6, 0.5, 0.4), odd_turn()));
        let table = scene.table();
        let turn = odd_turn().as_mat3();
        let floor = turn * Vec3::new(0.31, -0.2, -0.4);
        let bundle = Bundle::new(IRRADIANCE_WALKS, 4);
        let of_walls = |seen: &Seen| if matches!(seen, Seen::Hit(_)) { Vec3::ONE } else { Vec3::ZERO };
        let inside = irradiance(&table, &Start::on(floor, turn * Vec3::Z), turn * Vec3::Z, &bundle, of_walls);
        assert!((inside - PI).abs().max_element() < 1e-4, "{inside}");
        let of_sky = |seen: &Seen| if matches!(seen, Seen::Sky(_)) { Vec3::ONE } else { Vec3::ZERO };
        let outside =
            irradiance(&table, &Start::on(floor * 100.0, turn * -Vec3::Z), turn * -Vec3::Z, &bundle, of_sky);
        assert!((outside - PI).abs().max_element() < 1e-4, "{outside}");
    }

    #[test]
    fn bright_wall_beside_a_floor_gives_its_form_factor() {
        let floor = sheet(DVec3::new(0.0, -4.0, 0.0), DVec3::X * 4.0, DVec3::Y * 8.0, 0);
        let wall = sheet(DVec3::new(0.0, -20.0, 0.0), DVec3::Y * 40.0, DVec3::Z, 1);
        let scene = Scene::new(0.1, 0..7, &[floor, wall].concat());
        let table = scene.table();
        let bright = |seen: &Seen| match seen {
            Seen::Hit(hit) if scene.surface(hit.patch) == 1 => Vec3::ONE,
            _ => Vec3::ZERO,
        };
        for away in [0.13_f32, 0.5, 1.7] {
            let mean = |walks: u32| {
                let of = |identity| {
                    let bundle = Bundle::new(walks, identity);
                    {
                        let start = Start::on(Vec3::new(away, 0.02, 0.0), Vec3::Z);
                        irradiance(&table, &start, Vec3::Z, &bundle, bright).x
                    }
                };
                (0..256).map(of).sum::<f32>() / 256.0
            };
            let wanted = PI * 0.5 * (1.0 - away / (away * away + 1.0).sqrt());
            let [few, many] = [mean(16), mean(64)];
            println!("{away}: {:.4} {:.4}", few / wanted, many / wanted);
            assert!((many / wanted - 1.0).abs() < 0.05, "{away}: {many}, not {wanted}");
        }
    }

    #[test]
    fn occlusion_is_that_of_a_sphere_within_it_and_none_in_the_open() {
        let scene = Scene::new(0.05, 0..6, &sphere_shell(0.6, 4));
        let bundle = Bundle::new(OCCLUSION_WALKS, 1);
        let of = |at_m, reach_m| {
            ambient_occlusion(&scene.table(), &Start::on(at_m, Vec3::Y), Vec3::Y, &bundle, reach_m)
        };
        // All walks from the middle are 0.6 m long.
        let middle = of(Vec3::ZERO, OCCLUSION_REACH_M);
        assert!((middle - (1.0 - 0.4 * 0.4)).abs() < 0.02, "{middle}");
        assert_eq!(of(Vec3::ZERO, 0.5), 1.0);
        assert_eq!(of(Vec3::Y * 10.0, OCCLUSION_REACH_M), 1.0);
        // On the sphere t = 2r cosθ, and cos²θ is uniform: 1 − ∫ (1 − 1.2 √u)² over u up to 1/1.44.
        let root = 1.0 / 1.2_f32;
        let wanted = 1.0 - (root.powi(2) - 1.6 * root.powi(3) + 0.72 * root.powi(4));
        let low = of(Vec3::Y * -0.599, OCCLUSION_REACH_M);
        assert!((low - wanted).abs() < 0.05, "{low} {wanted}");
    }
}
