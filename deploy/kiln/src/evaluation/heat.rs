//! Signed differences as colours: blue where the bake is too dark, white where it is right, red where it is too bright.

use lightkiln_client::passes::atlas::Lightmap;
use lightkiln_worker::evaluate::LightResult;
use lightkiln_worker::reference::luminance;

use super::measure::Measured;

/// Difference, over the mean of the reference, that is shown in full colour.
pub const FULL_COLOUR: f64 = 0.5;
/// Longest side of an atlas picture in pixels; larger pages are shrunk.
const ATLAS_SIDE_MAX: u32 = 512;
/// Texels without receiver.
const BLANK: [u8; 4] = [64, 64, 64, 255];

/// The colour of a difference.
pub fn colour(relative: f64) -> [u8; 4] {
    let share = (relative / FULL_COLOUR).clamp(-1.0, 1.0);
    let fade = |end: f64| (255.0 + (end - 255.0) * share.abs()).round() as u8;
    match share {
        share if share < 0.0 => [fade(24.0), fade(64.0), fade(200.0), 255],
        _ => [fade(200.0), fade(24.0), fade(24.0), 255],
    }
}

/// A picture of 8-bit pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Bitmap {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row after row.
    pub pixels: Vec<[u8; 4]>,
}

/// The difference of E_ind on every atlas page: each texel as the nearest measured receiver of its block.
pub fn atlas(measured: &Measured, result: &LightResult, lightmap: &Lightmap<'_>) -> Vec<Bitmap> {
    let shrinks: Vec<u32> = lightmap
        .layout
        .pages
        .iter()
        .map(|page| page[0].max(page[1]).div_ceil(ATLAS_SIDE_MAX).max(1))
        .collect();
    let mut pages: Vec<Bitmap> = lightmap
        .layout
        .pages
        .iter()
        .zip(&shrinks)
        .map(|(page, shrink)| {
            let [width, height] = page.map(|side| side.div_ceil(*shrink));
            Bitmap { width, height, pixels: vec![BLANK; width as usize * height as usize] }
        })
        .collect();
    let differences = differences_by_block(measured, result, lightmap);
    for (index, block) in lightmap.layout.blocks.iter().enumerate() {
        if differences[index].is_empty() {
            continue;
        }
        let (shrink, page) = (shrinks[block.page as usize], &mut pages[block.page as usize]);
        for y in (0..block.size[1]).filter(|y| (block.origin[1] + y) % shrink == 0) {
            for x in (0..block.size[0]).filter(|x| (block.origin[0] + x) % shrink == 0) {
                if lightmap.slots.slot(index as u32, [x as u16, y as u16]).is_none() {
                    continue;
                }
                let squared = |[i, j]: [u16; 2]| {
                    (i64::from(i) - i64::from(x)).pow(2) + (i64::from(j) - i64::from(y)).pow(2)
                };
                let nearest = differences[index].iter().min_by_key(|(texel, _)| squared(*texel));
                let at = (block.origin[1] + y) / shrink * page.width + (block.origin[0] + x) / shrink;
                page.pixels[at as usize] = nearest.map_or(BLANK, |(_, relative)| colour(*relative));
            }
        }
    }
    pages
}

/// Texel and relative difference of the measured receivers of each block, in the atlas' order of blocks.
fn differences_by_block(
    measured: &Measured,
    result: &LightResult,
    lightmap: &Lightmap<'_>,
) -> Vec<Vec<([u16; 2], f64)>> {
    let mut by_block = vec![Vec::new(); lightmap.layout.blocks.len()];
    let Some(evaluated) = measured.evaluator.bake().lightmap() else { return by_block };
    for (index, sampled) in measured.evaluator.sample().places.iter().enumerate() {
        let Some((key, texel)) = evaluated.texel_of(&sampled.place) else { continue };
        let block = lightmap.layout.block_index(key);
        if let Some(block) = block.filter(|_| result.counted[index]) {
            let difference = luminance(result.baked[index]) - result.reference[index].indirect.luminance();
            let relative = difference / result.figures.mean_irradiance.max(f64::MIN_POSITIVE);
            by_block[block as usize].push((texel, relative));
        }
    }
    by_block
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn right_is_white_too_dark_is_blue_and_too_bright_is_red() {
        assert_eq!(colour(0.0), [255; 4]);
        let ([r, _, b, _], [r2, _, b2, _]) = (colour(-0.2), colour(0.2));
        assert!(b > r && r2 > b2);
        assert_eq!(colour(9.0), colour(FULL_COLOUR));
        assert_eq!(colour(-9.0), colour(-FULL_COLOUR));
    }
}
