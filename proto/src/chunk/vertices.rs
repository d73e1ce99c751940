//! Arrays of vectors over all draws: each component on its own, as f32 or in whole steps of a fixed size.

use super::bytes::Reader;
use super::error::{ChunkError, in_range};
use super::ints;

/// Numbers as they are.
const AS_F32: u8 = 0;
/// Whole steps, as differences from the number before.
const AS_STEPS: u8 = 1;
/// Most steps from zero: 2²⁴, so that a step count is exact in f32.
const STEPS_MAX: i32 = 1 << 24;

/// When numbers may be stored in whole steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Steps {
    /// Never.
    Never,
    /// Steps of 1/255, where every number is one exactly.
    Exact255,
    /// Steps of 1/256, rounded: an error of at most [`LIGHTMAP_ERROR_TEXELS`].
    Near256,
}

/// Largest error of a stored lightmap coordinate, in texels (exact beyond ±65,536 texels, where f32 is stored).
pub const LIGHTMAP_ERROR_TEXELS: f32 = 1.0 / 512.0;

impl Steps {
    fn per_unit(self) -> f32 {
        if self == Self::Exact255 { 255.0 } else { 256.0 }
    }

    fn code(self, number: f32) -> Option<i32> {
        let steps = libm::roundf(number * self.per_unit());
        let close = match self {
            Self::Never => false,
            Self::Exact255 => self.number(steps as i32).to_bits() == number.to_bits(),
            Self::Near256 => true,
        };
        (close && steps.abs() <= STEPS_MAX as f32).then_some(steps as i32)
    }

    fn number(self, code: i32) -> f32 {
        code as f32 / self.per_unit()
    }
}

/// Appends vectors: in steps if all of them can be, else as f32.
pub(super) fn put_vectors<'a, const N: usize>(
    out: &mut Vec<u8>,
    vectors: impl Iterator<Item = &'a [f32; N]> + Clone,
    steps: Steps,
) {
    let coded =
        steps != Steps::Never && vectors.clone().flatten().all(|&number| steps.code(number).is_some());
    out.push(if coded { AS_STEPS } else { AS_F32 });
    for axis in 0..N {
        let numbers = vectors.clone().map(|vector| vector[axis]);
        if coded {
            ints::put_deltas(out, numbers.map(|number| steps.code(number).unwrap_or_default()));
        } else {
            ints::put_f32_planes(out, &numbers.collect::<Vec<_>>());
        }
    }
}

/// Reads `count` vectors.
pub(super) fn take_vectors<const N: usize>(
    reader: &mut Reader,
    count: usize,
    steps: Steps,
) -> Result<Vec<[f32; N]>, ChunkError> {
    let what = reader.section();
    let mode = reader.u8("mode")?;
    let coded_max = if steps == Steps::Never { AS_F32 } else { AS_STEPS };
    let coded = in_range(what, "mode", mode.into(), 0, coded_max.into())? == usize::from(AS_STEPS);
    let mut vectors = vec![[0.0; N]; count];
    for axis in 0..N {
        let numbers = if coded {
            let codes = ints::take_deltas(reader, what, count, -STEPS_MAX..=STEPS_MAX)?;
            codes.into_iter().map(|code| steps.number(code)).collect()
        } else {
            ints::take_f32_planes(reader, what, count)?
        };
        vectors.iter_mut().zip(numbers).for_each(|(vector, number)| vector[axis] = number);
    }
    Ok(vectors)
}

/// Most raw bytes of `count` vectors of up to four components.
pub(super) fn vectors_bytes_max(count: usize) -> u64 {
    1 + 4 * ints::bytes_max(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip(vectors: &[[f32; 2]], steps: Steps) -> (usize, Vec<[f32; 2]>) {
        let mut out = Vec::new();
        put_vectors(&mut out, vectors.iter(), steps);
        let mut reader = Reader::new("test", &out);
        let found = take_vectors(&mut reader, vectors.len(), steps).unwrap();
        reader.end().unwrap();
        (out.len(), found)
    }

    #[test]
    fn bytes_are_exact_and_small_and_other_numbers_stay_f32() {
        let bytes: Vec<[f32; 2]> = (0..=255).map(|k| [k as f32 / 255.0, 1.0]).collect();
        let (length, found) = round_trip(&bytes, Steps::Exact255);
        assert_eq!(found, bytes);
        assert!(length < 1000, "{length}");
        let others = [[0.1, 1e-9], [-3.7, 1e30]];
        assert_eq!(round_trip(&others, Steps::Exact255).1, others);
        assert_eq!(round_trip(&others, Steps::Never).1, others);
    }

    #[test]
    fn no_vectors_at_all_survive_whatever_the_steps() {
        for steps in [Steps::Never, Steps::Exact255, Steps::Near256] {
            assert!(round_trip(&[], steps).1.is_empty());
        }
    }

    #[test]
    fn lightmap_coordinates_stay_within_their_error_and_far_ones_are_exact() {
        let near = [[0.123, 4095.997], [-0.5, 17.0]];
        for (found, wanted) in
            round_trip(&near, Steps::Near256).1.as_flattened().iter().zip(near.as_flattened())
        {
            assert!((found - wanted).abs() <= LIGHTMAP_ERROR_TEXELS);
        }
        let far = [[0.123, 1e9], [0.0, 0.0]];
        assert_eq!(round_trip(&far, Steps::Near256).1, far);
    }
}
