//! ꟻLIP [Andersson2020] of two pictures as a screen shows them: how different they look, 0..=1, by NVIDIA's own code.

use nv_flip::{DEFAULT_PIXELS_PER_DEGREE, FlipImageRgb8, FlipPool, flip, magma_lut};

/// How different two pictures look.
pub struct Flip {
    /// Mean over pixels: 0 the same, 1 as different as can be.
    pub mean: f64,
    /// Difference of each pixel, dark to bright.
    pub map: Vec<[u8; 4]>,
}

/// Compares two pictures of the same size.
pub fn difference(width: u32, height: u32, reference: &[[u8; 4]], test: &[[u8; 4]]) -> Flip {
    let picture = |pixels: &[[u8; 4]]| {
        let bytes: Vec<u8> = pixels.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect();
        FlipImageRgb8::with_data(width, height, &bytes)
    };
    let map = flip(picture(reference), picture(test), DEFAULT_PIXELS_PER_DEGREE);
    let mean = f64::from(FlipPool::from_image(&map).mean());
    let coloured = map.apply_color_lut(&magma_lut()).to_vec();
    Flip { mean, map: coloured.chunks_exact(3).map(|rgb| [rgb[0], rgb[1], rgb[2], 255]).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_pictures_do_not_differ_and_black_from_white_does_wholly() {
        let (black, white) = (vec![[0, 0, 0, 255]; 64], vec![[255; 4]; 64]);
        let grey = vec![[128, 128, 128, 255]; 64];
        assert_eq!(difference(8, 8, &black, &black).mean, 0.0);
        let [far, near] = [&white, &grey].map(|test| difference(8, 8, &black, test).mean);
        assert!(far > 0.9 && near < far && near > 0.1, "{far} {near}");
        assert_eq!(difference(8, 8, &black, &grey).map.len(), 64);
    }
}
