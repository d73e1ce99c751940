//! Pictures whose walks are of few pixels beside those whose walks are of all.

use std::path::Path;
use std::time::Instant;

use anyhow::{Result, ensure};
use glam::{Vec2, Vec4};
use lightkiln_client::frame::Frame;
use lightkiln_client::passes::walk::Walks;
use lightkiln_client::picture::{Exposure, Tone, developed};
use lightkiln_client::preview::View;

use super::{LIMIT, Stage, keep, ssim};

/// Size of pictures: walks are slow in software.
const SIZE: [u32; 2] = [480, 270];
/// Samples of a pixel of pictures that are means.
const SAMPLES: u32 = 8;
/// Steps of Roberts' sequence along both axes.
const STEP: Vec2 = Vec2::new(0.754_877_7, 0.569_840_3);

/// A picture of walks from every so manieth pixel.
#[derive(Clone, Copy, Debug)]
pub struct Walked {
    /// Pixels along a side of those that walks are of.
    pub step: u32,
    /// Best time of a frame in milliseconds.
    pub frame_ms: f64,
    /// Structural similarity of a mean of samples to that of walks of all pixels.
    pub ssim: f64,
    /// The same of one sample, as a window shows it at first, to that mean.
    pub ssim_of_one: f64,
}

/// Steps of 1 to 4 pixels. Pictures go to `folder` if there is one, with differences eight times as strong.
pub fn walked(stage: &Stage, view: &View, folder: Option<&Path>) -> Result<Vec<Walked>> {
    let [width, height] = SIZE;
    let view = View { width, height, ..view.clone() };
    let mut frame = stage.frame(&view)?;
    let (bounces, converged) = frame.settle(LIMIT)?;
    ensure!(converged, "light has not settled after {bounces} bounces");
    let mut wanted: Option<(Vec<[u8; 4]>, f32)> = None;
    let mut found = Vec::new();
    for step in 1..=4 {
        frame.set_walks(Walks { step, ..view.walks })?;
        let Sampled { mean, one, frame_ms } = sampled(stage, &mut frame)?;
        let exposure =
            wanted.as_ref().map_or_else(|| Exposure::default().factor(&mean), |(_, exposure)| *exposure);
        let [mean, one] = [mean, one].map(|of| {
            let radiance: Vec<[f32; 3]> = of.iter().map(|of| of.truncate().into()).collect();
            developed(&radiance, exposure, Tone::Filmic)
        });
        let (wanted, _) = wanted.get_or_insert_with(|| (mean.clone(), exposure));
        if let Some(folder) = folder {
            keep(folder, &format!("walks {step}"), &view, [&mean, wanted])?;
        }
        let [ssim, ssim_of_one] = [&mean, &one].map(|of| ssim(width as usize, wanted, of));
        found.push(Walked { step, frame_ms, ssim, ssim_of_one });
    }
    Ok(found)
}

struct Sampled {
    mean: Vec<Vec4>,
    one: Vec<Vec4>,
    frame_ms: f64,
}

fn sampled(stage: &Stage, frame: &mut Frame<'_>) -> Result<Sampled> {
    let (mut sum, mut one, mut frame_ms) = (Vec::new(), Vec::new(), f64::INFINITY);
    for sample in 0..SAMPLES {
        let start = Instant::now();
        frame.draw(((STEP * sample as f32).fract() - 0.5).to_array())?;
        stage.gpu.poll(true)?;
        frame_ms = frame_ms.min(1000.0 * start.elapsed().as_secs_f64());
        let drawn = frame.read()?;
        if sample == 0 {
            (sum, one) = (drawn.clone(), drawn);
        } else {
            sum.iter_mut().zip(drawn).for_each(|(sum, drawn)| *sum += drawn);
        }
    }
    sum.iter_mut().for_each(|sum| *sum /= SAMPLES as f32);
    Ok(Sampled { mean: sum, one, frame_ms })
}
