//! Codes of single quantities, each with its stated error: positions, normals, albedo, irradiance.
//!
//! Only +, −, ×, ÷, √ and `libm` are used, so every machine gives the same codes.

/// Largest angle between a unit normal and its decoded code, in radians.
pub const NORMAL_ERROR_RAD: f32 = 1.0e-4;
/// Relative error of a coded irradiance: half a step of 1/512 octave, 2^(1/1024) − 1.
pub const IRRADIANCE_RELATIVE_ERROR: f32 = 6.8e-4;
/// Smallest irradiance that is kept, in W·m⁻²; less becomes 0. Exactly 0 stays exactly 0.
pub const IRRADIANCE_MIN: f32 = 5.5e-20;
/// Largest irradiance that can be coded, in W·m⁻²; the encoder refuses more.
pub const IRRADIANCE_MAX: f32 = 1.8e19;
/// Albedo above this is coded as this.
pub const ALBEDO_MAX: f32 = 0.999;
/// Largest difference between an albedo up to [`ALBEDO_MAX`] and its decoded 8-bit code.
pub const ALBEDO_ERROR: f32 = 0.004;

const STEPS_PER_OCTAVE: f64 = 512.0;
const CODE_OF_ONE: f64 = 32_768.0;

/// Code of a coordinate in `bounds` (16 bits): `q = round(65535·(x − lo)/(hi − lo))`.
pub(super) fn position_code(x: f32, bounds: [f32; 2]) -> u16 {
    let [lo, hi] = bounds.map(f64::from);
    if hi <= lo {
        0
    } else {
        libm::round((f64::from(x) - lo) / (hi - lo) * 65_535.0).clamp(0.0, 65_535.0) as u16
    }
}

/// `x = lo + (hi − lo)·q/65535`; exact at both ends.
pub(super) fn position_of(code: u16, bounds: [f32; 2]) -> f32 {
    let [lo, hi] = bounds.map(f64::from);
    (lo + (hi - lo) * (f64::from(code) / 65_535.0)) as f32
}

/// Largest error of a decoded coordinate in `bounds`, in metres: half a step, and rounding to f32.
pub fn position_error_m(bounds: [f32; 2]) -> f32 {
    let largest = bounds[0].abs().max(bounds[1].abs());
    (bounds[1] - bounds[0]) / 131_070.0 + largest * f32::EPSILON
}

/// Octahedral code of a unit vector: the octahedron |x| + |y| + |z| = 1 with its lower half folded outwards,
/// as two numbers in −32767…32767.
pub fn normal_code(normal: [f32; 3]) -> [i16; 2] {
    let [x, y, z] = normal.map(f64::from);
    let length = x.abs() + y.abs() + z.abs();
    if length == 0.0 {
        return [0, 0];
    }
    let (u, v) = (x / length, y / length);
    let (u, v) = if z < 0.0 { fold(u, v) } else { (u, v) };
    [u, v].map(|w| libm::round(w * 32_767.0) as i16)
}

/// Unit vector of an octahedral code.
pub fn normal_of(code: [i16; 2]) -> [f32; 3] {
    let [u, v] = code.map(|w| f64::from(w.max(-32_767)) / 32_767.0);
    let z = 1.0 - u.abs() - v.abs();
    let (x, y) = if z < 0.0 { fold(u, v) } else { (u, v) };
    let length = (x * x + y * y + z * z).sqrt();
    [x, y, z].map(|w| (w / length) as f32)
}

fn fold(u: f64, v: f64) -> (f64, f64) {
    let sign = |w: f64| if w < 0.0 { -1.0 } else { 1.0 };
    ((1.0 - v.abs()) * sign(u), (1.0 - u.abs()) * sign(v))
}

/// Code of an albedo: `q = round(255·√(ρ/ALBEDO_MAX))`.
pub(super) fn albedo_code(albedo: f32) -> u8 {
    let share = (f64::from(albedo) / f64::from(ALBEDO_MAX)).clamp(0.0, 1.0);
    libm::round(share.sqrt() * 255.0) as u8
}

/// `ρ = ALBEDO_MAX·(q/255)²`.
pub(super) fn albedo_of(code: u8) -> f32 {
    let root = f64::from(code) / 255.0;
    (f64::from(ALBEDO_MAX) * root * root) as f32
}

/// Code of an irradiance: 0 for 0, else `32768 + round(512·log₂ E)`.
pub(super) fn irradiance_code(irradiance: f32) -> u16 {
    if irradiance < IRRADIANCE_MIN {
        return 0;
    }
    let code = CODE_OF_ONE + libm::round(STEPS_PER_OCTAVE * libm::log2(f64::from(irradiance)));
    code.clamp(1.0, 65_535.0) as u16
}

/// `E = 2^((q − 32768)/512)`, and 0 for q = 0.
pub(super) fn irradiance_of(code: u16) -> f32 {
    if code == 0 { 0.0 } else { libm::exp2((f64::from(code) - CODE_OF_ONE) / STEPS_PER_OCTAVE) as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn axes_and_zero_are_exact() {
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                let mut normal = [0.0; 3];
                normal[axis] = sign;
                assert_eq!(normal_of(normal_code(normal)).map(|x| x + 0.0), normal);
            }
        }
        assert_eq!(irradiance_of(irradiance_code(0.0)), 0.0);
        assert_eq!(irradiance_of(irradiance_code(1.0)), 1.0);
        assert_eq!(albedo_of(albedo_code(0.0)), 0.0);
        assert!(irradiance_of(u16::MAX).is_finite() && albedo_of(255) < 1.0);
    }

    proptest! {
        #[test]
        fn position_stays_within_its_error(lo in -1e3_f32..1e3, size in 0.0_f32..1e3, share in 0.0_f32..=1.0) {
            let bounds = [lo, lo + size];
            let x = (lo + share * (bounds[1] - lo)).min(bounds[1]);
            prop_assert!((position_of(position_code(x, bounds), bounds) - x).abs() <= position_error_m(bounds));
            for end in bounds {
                prop_assert_eq!(position_of(position_code(end, bounds), bounds), end);
            }
        }

        #[test]
        fn normal_stays_within_its_error(v in prop::array::uniform3(-1.0_f32..1.0)) {
            let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
            prop_assume!(length > 1e-3);
            let normal = v.map(|x| x / length);
            let decoded = normal_of(normal_code(normal));
            let apart: f32 = normal.iter().zip(decoded).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt();
            prop_assert!(apart <= NORMAL_ERROR_RAD, "{apart}");
        }

        #[test]
        fn albedo_stays_within_its_error(albedo in 0.0_f32..ALBEDO_MAX) {
            prop_assert!((albedo_of(albedo_code(albedo)) - albedo).abs() <= ALBEDO_ERROR);
        }

        #[test]
        fn irradiance_stays_within_its_error(exponent in -60.0_f32..60.0) {
            let irradiance = libm::exp2f(exponent);
            let decoded = irradiance_of(irradiance_code(irradiance));
            prop_assert!((decoded / irradiance - 1.0).abs() <= IRRADIANCE_RELATIVE_ERROR);
        }
    }
}
