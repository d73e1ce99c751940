//! The picture of a panorama, and a small one of the same light.

use std::f64::consts::PI;
use std::fmt;

use glam::Vec3;

/// Most pixels of a panorama: 8192 × 4096.
pub const PANORAMA_PIXELS_MAX: usize = 1 << 25;
/// Brightest pixel in W·m⁻²·sr⁻¹: sums over the sky stay far below the largest 32-bit number.
pub(super) const RADIANCE_MAX: f32 = 1e30;
/// Columns and rows from which on a pixel counts as one direction: larger pictures are reduced to so many, pixels of coarser
/// ones are cut into several.
pub(super) const FINE: [u32; 2] = [1024, 512];
/// Widest panorama, in heights; the narrowest is a square.
const WIDEST: u64 = 4;

/// Rows of pixels, the uppermost first.
#[derive(Clone, PartialEq)]
pub(super) struct Grid {
    pub width: u32,
    pub height: u32,
    pub pixels: Vec<[f32; 3]>,
}

impl Grid {
    pub fn pixel(&self, x: u32, y: u32) -> Vec3 {
        Vec3::from(self.pixels[y as usize * self.width as usize + x as usize])
    }

    /// The same light in [`FINE`] pixels at most, each the mean by solid angle; `None` where it has no more.
    fn reduced(&self) -> Option<Self> {
        let [width, height] = [self.width.min(FINE[0]), self.height.min(FINE[1])];
        if [width, height] == [self.width, self.height] {
            return None;
        }
        let columns = pieces(self.width, width);
        let up = |edge: f64| libm::cos(edge * PI);
        let mut sums = vec![[0.0_f64; 3]; width as usize * height as usize];
        let rows = self.pixels.chunks_exact(self.width as usize);
        let lines: Vec<&[[f32; 3]]> = rows.collect();
        for down in pieces(self.height, height) {
            let [upper, lower] = [down.into, down.into + 1].map(|edge| up(edge as f64 / f64::from(height)));
            let share = (up(down.from) - up(down.to)) / (upper - lower) * f64::from(width);
            let sums = &mut sums[down.into * width as usize..];
            for across in &columns {
                let weight = share * (across.to - across.from);
                for (sum, value) in sums[across.into].iter_mut().zip(lines[down.cell][across.cell]) {
                    *sum += weight * f64::from(value);
                }
            }
        }
        let pixels = sums.iter().map(|sum| sum.map(|channel| channel as f32)).collect();
        Some(Self { width, height, pixels })
    }
}

/// A part of a cell that lies in one larger cell, the whole being from 0 to 1.
struct Piece {
    cell: usize,
    into: usize,
    from: f64,
    to: f64,
}

/// The parts of so many cells alike in fewer ones alike, in order.
fn pieces(cells: u32, into: u32) -> Vec<Piece> {
    let (cells, into) = (u64::from(cells), u64::from(into));
    // Both have whole edges in steps of 1/(cells · into).
    let end = cells * into;
    let share = |step: u64| step as f64 / end as f64;
    let (mut pieces, mut at) = (Vec::new(), 0);
    while at < end {
        let (cell, larger) = (at / into, at / cells);
        let next = ((cell + 1) * into).min((larger + 1) * cells);
        pieces.push(Piece { cell: cell as usize, into: larger as usize, from: share(at), to: share(next) });
        at = next;
    }
    pieces
}

/// Pixels of a panorama in equirectangular projection, the uppermost row first.
#[derive(Clone, PartialEq)]
pub struct PanoramaImage {
    name: String,
    /// Linear Rec.709 radiance in W·m⁻²·sr⁻¹.
    full: Grid,
    /// The same light in fewer pixels, of a large one.
    reduced: Option<Grid>,
    brightest: f32,
}

impl PanoramaImage {
    /// Checks the pixels of a panorama; `name` is its file's.
    ///
    /// Errors where they are none, too many or not as many as the sides say, where the picture is not about twice as wide as
    /// high, and where a pixel is negative, not finite or beyond all measure.
    pub fn new(name: String, width: u32, height: u32, pixels: Vec<[f32; 3]>) -> Result<Self, String> {
        check_shape(width, height, pixels.len())?;
        let is_radiance = |pixel: &[f32; 3]| pixel.iter().all(|value| (0.0..=RADIANCE_MAX).contains(value));
        if let Some(bad) = pixels.iter().position(|pixel| !is_radiance(pixel)) {
            let (x, y) = (bad as u32 % width, bad as u32 / width);
            return Err(format!("its pixel {x},{y} is negative, not finite or above {RADIANCE_MAX:e}"));
        }
        let brightest = pixels.iter().flatten().copied().fold(0.0, f32::max);
        let full = Grid { width, height, pixels };
        let reduced = full.reduced();
        Ok(Self { name, full, reduced, brightest })
    }

    /// Its file, for messages and commands.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Width and height in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.full.width, self.full.height]
    }

    /// Row after row.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.full.pixels
    }

    /// Largest number of all pixels, W·m⁻²·sr⁻¹.
    pub fn brightest(&self) -> f32 {
        self.brightest
    }

    pub(super) fn pixel(&self, x: u32, y: u32) -> Vec3 {
        self.full.pixel(x, y)
    }

    /// Its light in no more pixels than means need.
    pub(super) fn light(&self) -> &Grid {
        self.reduced.as_ref().unwrap_or(&self.full)
    }
}

fn check_shape(width: u32, height: u32, pixels: usize) -> Result<(), String> {
    let [wide, high] = [width, height].map(u64::from);
    let size = format!("it has {width} × {height} pixels");
    if wide * high == 0 {
        return Err(format!("{size}: give a picture that has some"));
    }
    if wide * high > PANORAMA_PIXELS_MAX as u64 {
        return Err(format!("{size}, more than the {PANORAMA_PIXELS_MAX} of a panorama: make it smaller"));
    }
    if wide * high != pixels as u64 {
        return Err(format!("{size}, but {pixels} colours: give as many"));
    }
    if wide < high || wide > WIDEST * high {
        return Err(format!(
            "{size}; one of the whole sky is twice as wide as high, and 1 to {WIDEST} times is read: \
             convert it to equirectangular projection"
        ));
    }
    Ok(())
}

impl fmt::Debug for PanoramaImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [width, height] = self.size();
        write!(f, "PanoramaImage({}, {width} × {height})", self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_cells_fill_the_whole() {
        for (cells, into) in [(7, 3), (8, 4), (5, 5), (4096, 512), (1, 1)] {
            let pieces = pieces(cells, into);
            assert_eq!((pieces[0].from, pieces[pieces.len() - 1].to), (0.0, 1.0));
            assert!(pieces.windows(2).all(|pair| pair[0].to == pair[1].from && pair[0].from < pair[0].to));
            for piece in &pieces {
                let middle = 0.5 * (piece.from + piece.to);
                let at = [cells, into].map(|count| (middle * f64::from(count)) as usize);
                assert_eq!(at, [piece.cell, piece.into], "{cells} into {into}");
            }
        }
    }

    #[test]
    fn reduced_picture_keeps_the_flux() {
        let (width, height) = (1500_u32, 700_u32);
        let of = |at: u32| [(at % 7) as f32, (at / width) as f32, 3.0];
        let pixels = (0..width * height).map(of).collect();
        let image = PanoramaImage::new("test".into(), width, height, pixels).unwrap();
        assert_eq!((image.light().width, image.light().height), (1024, 512));
        let flux = |grid: &Grid| {
            let up = |edge: u32| libm::cos(f64::from(edge) / f64::from(grid.height) * PI);
            let mut sum = [0.0; 3];
            for y in 0..grid.height {
                let solid_angle = (up(y) - up(y + 1)) / f64::from(grid.width);
                for x in 0..grid.width {
                    let pixel = grid.pixel(x, y).to_array();
                    sum.iter_mut().zip(pixel).for_each(|(sum, value)| *sum += solid_angle * f64::from(value));
                }
            }
            sum
        };
        let [found, wanted] = [image.light(), &image.full].map(flux);
        for (found, wanted) in found.iter().zip(wanted) {
            assert!((found / wanted - 1.0).abs() < 1e-6, "{found}, wanted {wanted}");
        }
    }

    #[test]
    fn pixels_that_are_no_radiance_and_shapes_that_are_no_sky_are_refused() {
        let refused =
            |width, height, pixels| PanoramaImage::new("test".into(), width, height, pixels).unwrap_err();
        let empty = refused(0, 4, Vec::new());
        assert!(empty.contains("0 × 4") && !empty.contains("smaller"), "{empty}");
        assert!(refused(2, 2, vec![[0.0; 3]; 3]).contains("2 × 2"));
        assert!(refused(u32::MAX, u32::MAX, Vec::new()).contains("smaller"));
        for (width, height) in [(1 << 16, 1), (1, 1 << 16), (9, 2), (2, 3)] {
            let error = refused(width, height, vec![[0.0; 3]; (width * height) as usize]);
            assert!(error.contains("twice as wide"), "{error}");
        }
        for (width, height) in [(1, 1), (8, 2), (3, 3)] {
            let pixels = vec![[0.0; 3]; (width * height) as usize];
            assert!(PanoramaImage::new("test".into(), width, height, pixels).is_ok());
        }
        let bad = |value| refused(2, 1, vec![[0.0; 3], [0.0, value, 0.0]]);
        assert!([f32::NAN, f32::INFINITY, -1.0, 1e31].iter().all(|value| bad(*value).contains("1,0")));
    }
}
