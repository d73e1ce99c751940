//! Quantities at public edges: a bare float never stands for two different things (METHOD.md §1).

use std::f32::consts::PI;

use serde::{Deserialize, Serialize};

/// Diffuse albedo ρ per Rec.709 channel, 0 ≤ ρ < 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Albedo(pub [f32; 3]);

/// Radiance L in W·m⁻²·sr⁻¹ per Rec.709 channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Radiance(pub [f32; 3]);

/// Irradiance E in W·m⁻² per Rec.709 channel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Irradiance(pub [f32; 3]);

/// Radiance that leaves a diffuse surface: `L = Lₑ + ρ/π · E` (METHOD.md §1).
pub fn leaving_radiance(emission: Radiance, albedo: Albedo, irradiance: Irradiance) -> Radiance {
    let mut radiance = emission;
    for ((l, rho), e) in radiance.0.iter_mut().zip(albedo.0).zip(irradiance.0) {
        *l += rho / PI * e;
    }
    radiance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surface_of_albedo_one_half_under_pi_radiates_one_half_and_its_own() {
        let radiance = leaving_radiance(Radiance([1.0; 3]), Albedo([0.5; 3]), Irradiance([PI; 3]));
        assert!(radiance.0.iter().all(|l| (l - 1.5).abs() < 1e-6));
    }
}
