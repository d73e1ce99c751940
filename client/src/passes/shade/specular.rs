//! Specular reflection by microfacets (METHOD.md §2.15); twin of `specular.wgsl`.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

/// Reflectance of dielectrics along the normal.
const DIELECTRIC: f32 = 0.04;
/// Least roughness. Lower → sharper images of lamps, and pixels between them that miss them.
const ROUGHNESS_MIN: f32 = 0.1;
/// Least cosine to the eye.
const EYE_MIN: f32 = 0.05;

/// How a point reflects; twin of `Gloss`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gloss {
    /// Share of the light that is left for diffuse reflection.
    pub diffuse: f32,
    /// Width of the microfacets' slopes; 0 where all reflection is diffuse.
    pub alpha: f32,
    /// Reflectance along the normal.
    pub f0: Vec3,
    /// Factor for light that microfacets pass on among themselves.
    pub gain: Vec3,
    /// Share of even light that is reflected.
    pub reflectance: Vec3,
    /// Towards the eye.
    pub eye: Vec3,
    /// Axis about which light is gathered.
    pub lobe: Vec3,
}

/// `Σ_{i+j≤4} a_ij r^i c^j`, rows by the power of r.
fn quartic(r: f32, c: f32, (r0, r1, r2, r3, r4): ([f32; 5], [f32; 4], [f32; 3], [f32; 2], f32)) -> f32 {
    let of_r0 = r0[0] + c * (r0[1] + c * (r0[2] + c * (r0[3] + c * r0[4])));
    let of_r1 = r1[0] + c * (r1[1] + c * (r1[2] + c * r1[3]));
    let of_r2 = r2[0] + c * (r2[1] + c * r2[2]);
    of_r0 + r * (of_r1 + r * (of_r2 + r * (r3[0] + c * r3[1] + r * r4)))
}

/// Share of even light that microfacets which reflect all reflect at once, by roughness and cosine to the eye, and the part of it in
/// `(1 − h·v)⁵`: fits to integrals over the hemisphere.
fn even_albedo(r: f32, c: f32) -> Vec2 {
    let all = quartic(
        r,
        c,
        (
            [1.0271, 0.2284, -0.0095, -0.9731, 0.6167],
            [-0.9966, -0.1048, 3.3627, -1.2791],
            [2.8099, -4.1626, -0.3271],
            [-2.8592, 1.9951],
            0.9722,
        ),
    );
    let grazing = quartic(
        r,
        c,
        (
            [1.035, -3.7387, 4.0641, -1.3103, -0.055],
            [-2.0838, 7.8941, -7.3108, 1.7221],
            [0.4977, -4.3892, 2.8402],
            [1.1694, 0.2727],
            -0.5884,
        ),
    );
    let whole = all.clamp(0.2, 1.0);
    Vec2::new(whole, grazing.clamp(0.0, whole))
}

/// Mirrors the direction to the eye at a normal.
pub(super) fn mirrored(eye: Vec3, normal: Vec3) -> Vec3 {
    normal * (2.0 * normal.dot(eye)) - eye
}

impl Gloss {
    /// Of a point seen from `eye`; diffuse alone where roughness is below 0.
    pub fn of(albedo: Vec3, [metallic, roughness]: [f32; 2], normal: Vec3, eye: Vec3) -> Self {
        if roughness < 0.0 {
            let none = Vec3::ZERO;
            return Self {
                diffuse: 1.0,
                alpha: 0.0,
                f0: none,
                gain: none,
                reflectance: none,
                eye,
                lobe: normal,
            };
        }
        let rough = roughness.clamp(ROUGHNESS_MIN, 1.0);
        let alpha = rough * rough;
        let metal = metallic.clamp(0.0, 1.0);
        let f0 = Vec3::splat(DIELECTRIC).lerp(albedo, metal);
        let once = even_albedo(rough, normal.dot(eye).clamp(EYE_MIN, 1.0));
        let lost = (1.0 - once.x) / once.x;
        let of_dielectric = (DIELECTRIC * (once.x - once.y) + once.y) * (1.0 + DIELECTRIC * lost);
        let gain = 1.0 + f0 * lost;
        let of_metal = (albedo * (once.x - once.y) + once.y) * (1.0 + albedo * lost);
        let reflectance = Vec3::splat(of_dielectric).lerp(of_metal, metal);
        // Wide lobes lean to the normal.
        let lean = (1.0 - alpha) * ((1.0 - alpha).sqrt() + alpha);
        let lobe = normal.lerp(mirrored(eye, normal), lean).normalize_or(normal);
        Self { diffuse: (1.0 - metal) * (1.0 - of_dielectric), alpha, f0, gain, reflectance, eye, lobe }
    }

    /// Something is reflected specularly.
    pub fn is_specular(&self) -> bool {
        self.alpha > 0.0
    }

    /// Radiance reflected towards the eye of light from a direction, over its irradiance: `D V F` (METHOD.md §2.15). `solid` is the
    /// cosine-weighted solid angle that the light spans, over 4π: its lobe is as much wider.
    pub fn microfacets(&self, normal: Vec3, towards: Vec3, solid: f32) -> Vec3 {
        let a2 = (self.alpha * self.alpha + solid).min(1.0);
        let middle = (self.eye + towards).normalize_or(normal);
        let to_eye = normal.dot(self.eye).clamp(EYE_MIN, 1.0);
        let to_light = normal.dot(towards).clamp(1e-3, 1.0);
        let to_middle = normal.dot(middle).clamp(0.0, 1.0);
        let spread = to_middle * to_middle * (a2 - 1.0) + 1.0;
        let slopes = a2 / (PI * spread * spread);
        let shading = to_light * (to_eye * to_eye * (1.0 - a2) + a2).sqrt()
            + to_eye * (to_light * to_light * (1.0 - a2) + a2).sqrt();
        let grazing = 1.0 - self.eye.dot(middle).clamp(0.0, 1.0);
        let fresnel = self.f0 + (1.0 - self.f0) * grazing.powi(5);
        fresnel * self.gain * (0.5 * slopes / shading)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫ f cosθ dω over the hemisphere, by half vectors drawn after the microfacets' slopes, without the gain.
    fn integral(f0: f32, roughness: f32, cosine: f32) -> f32 {
        const SIDE: u32 = 256;
        let eye = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
        let gloss = Gloss::of(Vec3::splat(f0), [1.0, roughness], Vec3::Z, eye);
        let a2 = gloss.alpha * gloss.alpha;
        let at = |index: u32| {
            let [u, v] = [index % SIDE, index / SIDE].map(|step| (step as f32 + 0.5) / SIDE as f32);
            let up2 = (1.0 - u) / (1.0 + (a2 - 1.0) * u);
            let (sine, around) = ((1.0 - up2).max(0.0).sqrt(), 2.0 * PI * v);
            let half = Vec3::new(sine * around.cos(), sine * around.sin(), up2.sqrt());
            let towards = half * (2.0 * half.dot(eye)) - eye;
            if towards.z <= 0.0 || half.dot(eye) <= 0.0 {
                return 0.0;
            }
            let spread = up2 * (a2 - 1.0) + 1.0;
            let density = a2 / (PI * spread * spread) * half.z / (4.0 * half.dot(eye));
            f64::from(gloss.microfacets(Vec3::Z, towards, 0.0).x * towards.z / density / gloss.gain.x)
        };
        ((0..SIDE * SIDE).map(at).sum::<f64>() / f64::from(SIDE * SIDE)) as f32
    }

    #[test]
    fn even_light_is_reflected_as_the_integral_over_the_hemisphere_says() {
        for roughness in [0.2, 0.5, 0.8, 1.0] {
            for cosine in [0.15, 0.4, 0.7, 1.0] {
                let once = even_albedo(roughness, cosine);
                let all = integral(1.0, roughness, cosine);
                assert!((once.x - all).abs() < 0.04, "{} and {all}: {roughness} {cosine}", once.x);
                let dielectric = integral(DIELECTRIC, roughness, cosine);
                let fitted = DIELECTRIC * (once.x - once.y) + once.y;
                assert!((fitted - dielectric).abs() < 0.05, "{fitted}, {dielectric}: {roughness} {cosine}");
            }
        }
    }

    /// White metals and white dielectrics send back all of an even light, whatever their roughness.
    #[test]
    fn white_surfaces_lose_nothing_in_even_light() {
        for roughness in [0.0, 0.3, 0.6, 0.9, 1.0] {
            for cosine in [0.01_f32, 0.3, 0.8, 1.0] {
                let eye = Vec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
                for metallic in [0.0, 0.4, 1.0] {
                    let gloss = Gloss::of(Vec3::ONE, [metallic, roughness], Vec3::Z, eye);
                    let back = gloss.diffuse + gloss.reflectance.x;
                    assert!((back - 1.0).abs() < 1e-5, "{back} at {roughness}, {cosine}, metal {metallic}");
                }
            }
        }
        let plain = Gloss::of(Vec3::ONE, [0.0, -1.0], Vec3::Z, Vec3::Z);
        assert_eq!((plain.diffuse, plain.reflectance, plain.is_specular()), (1.0, Vec3::ZERO, false));
    }

    #[test]
    fn smooth_surfaces_mirror_and_rough_ones_lean_to_the_normal() {
        let eye = Vec3::new(0.6, 0.0, 0.8);
        let lobe = |roughness| Gloss::of(Vec3::ONE, [1.0, roughness], Vec3::Z, eye).lobe;
        assert!(lobe(0.0).abs_diff_eq(Vec3::new(-0.6, 0.0, 0.8), 0.01), "{}", lobe(0.0));
        assert_eq!(lobe(1.0), Vec3::Z);
        assert!(lobe(0.9).z > lobe(0.6).z && lobe(0.6).z > lobe(0.2).z);
    }
}
