//! Levels of detail against all detail: time of a bounce, pictures, light at receivers, and how much light moves from frame to frame.

mod frames;
mod ssim;
mod walks;

use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use glam::Vec4;
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::frame::{Frame, FrameRoom};
use lightkiln_client::kinds;
use lightkiln_client::lights::{Caster, parse_camera, parse_lights};
use lightkiln_client::passes::gpu::Gpu;
use lightkiln_client::passes::shadow::ShadowRoom;
use lightkiln_client::picture::{Exposure, Tone, developed, write_png};
use lightkiln_client::preview::View;
use lightkiln_proto::relight::{LevelCount, Limit, Lod};
use lightkiln_proto::words::lod_from_text;

pub use frames::{Moved, moved};
pub use ssim::ssim;
pub use walks::{Walked, walked};

/// Bounces of pictures: closer than what is compared.
const LIMIT: Limit = Limit { bounces_max: 400, change_max: 3e-4 };
/// Rounds of timing, in each of which every setting has its turn: a machine that others use too is slow for all of them.
const ROUNDS: usize = 4;
/// Bounces that are timed together: whole cycles of turns.
const BOUNCES: u32 = 8;
const SIZE: [u32; 2] = [960, 540];

/// A bake, and the adapter that lights it.
pub struct Stage {
    gpu: Gpu,
    bake: LoadedBake,
}

/// Levels of detail under a name; none is all detail.
#[derive(Clone, Debug)]
pub struct Setup {
    /// Name in tables.
    pub name: String,
    /// Settings.
    pub lod: Option<Lod>,
}

/// Cost and gain of a setup.
#[derive(Clone, Debug)]
pub struct Found {
    /// Name of the setup.
    pub name: String,
    /// Work by level; none for all detail.
    pub counts: Option<Vec<LevelCount>>,
    /// Best time of a bounce in milliseconds, the mean over a cycle.
    pub bounce_ms: f64,
    /// Processor time of a bounce in milliseconds, of an adapter in software: other programs do not lengthen it. None elsewhere.
    pub processor_ms: Option<f64>,
    /// Root mean square error of E_ind over its mean, against all detail.
    pub error: f64,
    /// Sum of E_ind over that of all detail.
    pub energy: f64,
    /// Structural similarity of the picture.
    pub ssim: f64,
}

impl Setup {
    /// Reads `NAME: words`, words as `kiln preview --lod` takes them.
    pub fn parse(text: &str) -> Result<Self> {
        let (name, words) = text.split_once(':').with_context(|| format!("'{text}' is not NAME: words"))?;
        let lod = lod_from_text(words).with_context(|| format!("in '{text}'"))?;
        Ok(Self { name: name.trim().to_owned(), lod: Some(lod) })
    }
}

impl Found {
    /// Receivers that are computed, of all.
    pub fn receivers(&self) -> Option<[u64; 2]> {
        let counts = self.counts.as_ref()?;
        Some([
            counts.iter().map(|count| count.receivers_computed).sum(),
            counts.iter().map(|count| count.receivers).sum(),
        ])
    }

    /// Share of the factors' numbers that bounces read, those of clusters that take turns by their interval.
    pub fn numbers(&self) -> Option<f64> {
        let counts = self.counts.as_ref()?;
        let read = |count: &LevelCount| count.numbers_read as f64 / f64::from(count.interval.max(1));
        let all: u64 = counts.iter().map(|count| count.numbers).sum();
        Some(counts.iter().map(read).sum::<f64>() / all.max(1) as f64)
    }
}

impl Stage {
    /// Opens a bundle and the best adapter.
    pub fn open(bundle: &Path) -> Result<Self> {
        let bake = LoadedBake::load(&Source::bundle(bundle)?, &kinds::all())?;
        Ok(Self { gpu: Gpu::open()?, bake })
    }

    /// Name of the adapter.
    pub fn adapter(&self) -> &str {
        &self.gpu.name
    }

    /// Receivers that have stand-ins, of all; none for a bake without levels of detail.
    pub fn stand_ins(&self) -> Option<[usize; 2]> {
        let table = self.bake.light.lod_table()?;
        Some([table.stand_ins.iter().map(Vec::len).sum(), table.order.len()])
    }

    /// A view by words of a camera and of lights.
    pub fn view(&self, camera: &str, lights: &[String]) -> Result<View> {
        let (camera, lights) = (parse_camera(camera)?, parse_lights(lights)?);
        let (view, _) = View::of_bake(&self.bake, Some(camera), Some(lights.lights))?;
        let [width, height] = SIZE;
        let scale = lights.emitter_scale.unwrap_or(1.0);
        let emitter_scale = vec![scale; view.emitter_scale.len()];
        Ok(View { width, height, emitter_scale, ..view })
    }

    fn frame(&self, view: &View) -> Result<Frame<'_>> {
        let shadows = ShadowRoom::for_lights(&Caster::of(&view.lights), 1024)?;
        let room = FrameRoom { size: [view.width, view.height], shadows };
        let mut frame = Frame::new(&self.gpu, &self.bake, room, view.camera.clone())?;
        frame.set_lights(&view.lights)?;
        frame.set_emitters(&view.emitter_scale)?;
        Ok(frame)
    }

    /// All detail, then each setup. Pictures go to `folder` if there is one, with differences eight times as strong.
    pub fn measured(&self, view: &View, setups: &[Setup], folder: Option<&Path>) -> Result<Vec<Found>> {
        let mut frame = self.frame(view)?;
        let all = Setup { name: "all detail".to_owned(), lod: None };
        let setups: Vec<&Setup> = [&all].into_iter().chain(setups).collect();
        let mut lit = Vec::new();
        for setup in &setups {
            lit.push(Lit::of(&mut frame, setup)?);
        }
        let times = self.timed(&mut frame, &setups)?;
        let (reference, exposure) = (&lit[0], Exposure::default().factor(&lit[0].radiance));
        let shown = |lit: &Lit| -> Vec<[u8; 4]> {
            let radiance: Vec<[f32; 3]> = lit.radiance.iter().map(|of| of.truncate().into()).collect();
            developed(&radiance, exposure, Tone::Filmic)
        };
        let wanted = shown(reference);
        let mut found = Vec::new();
        for ((setup, lit), times) in setups.iter().zip(&lit).zip(times) {
            let pixels = shown(lit);
            if let Some(folder) = folder {
                keep(folder, &setup.name, view, [&pixels, &wanted])?;
            }
            let ms = |time: Duration| time.as_secs_f64() * 1000.0;
            let [error, energy] = compared(&lit.indirect, &reference.indirect);
            found.push(Found {
                name: setup.name.clone(),
                counts: lit.counts.clone(),
                bounce_ms: ms(times.best.unwrap_or_default()),
                processor_ms: times.processor.map(|time| ms(time / ROUNDS as u32)),
                error,
                energy,
                ssim: ssim(view.width as usize, &wanted, &pixels),
            });
        }
        Ok(found)
    }

    /// Times of a bounce by setup.
    fn timed(&self, frame: &mut Frame<'_>, setups: &[&Setup]) -> Result<Vec<Times>> {
        let mut times = vec![Times::default(); setups.len()];
        for _ in 0..ROUNDS {
            for (setup, times) in setups.iter().zip(&mut times) {
                frame.set_lod(setup.lod)?;
                self.gpu.poll(true)?;
                let (start, before) = (Instant::now(), processor_time());
                for _ in 0..BOUNCES {
                    frame.advance()?;
                }
                self.gpu.poll(true)?;
                let (wall, after) = (start.elapsed() / BOUNCES, processor_time());
                times.best = Some(times.best.map_or(wall, |best: Duration| best.min(wall)));
                let own = after
                    .zip(before)
                    .filter(|_| self.gpu.software)
                    .map(|(after, before)| (after - before) / BOUNCES);
                times.processor = own.map(|own| times.processor.unwrap_or_default() + own);
            }
        }
        Ok(times)
    }
}

/// Times of a bounce.
#[derive(Clone, Copy, Debug, Default)]
struct Times {
    best: Option<Duration>,
    /// Sum of all rounds.
    processor: Option<Duration>,
}

/// Processor time of this process so far, as Linux tells it in hundredths of a second.
fn processor_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // The name before may have spaces; times are the 12th and 13th words behind it.
    let words: Vec<&str> = text.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks: u64 = words.get(11)?.parse::<u64>().ok()? + words.get(12)?.parse::<u64>().ok()?;
    Some(Duration::from_millis(10 * ticks))
}

/// Light of a setup that has settled.
struct Lit {
    indirect: Vec<Vec4>,
    radiance: Vec<Vec4>,
    counts: Option<Vec<LevelCount>>,
}

impl Lit {
    fn of(frame: &mut Frame<'_>, setup: &Setup) -> Result<Self> {
        frame.set_lod(setup.lod)?;
        let (bounces, converged) = frame.settle(LIMIT)?;
        anyhow::ensure!(converged, "'{}' has not settled after {bounces} bounces", setup.name);
        frame.draw([0.0; 2])?;
        let light = frame.read_receivers()?.context("the bake has no receivers")?;
        let counts = frame.lod_counts().map(Vec::from);
        Ok(Self { indirect: light.indirect, radiance: frame.read()?, counts })
    }
}

/// Error and energy of light against other light.
fn compared(found: &[Vec4], wanted: &[Vec4]) -> [f64; 2] {
    let luminance = |light: &Vec4| {
        0.2126 * f64::from(light.x) + 0.7152 * f64::from(light.y) + 0.0722 * f64::from(light.z)
    };
    let [sum, total] = [found, wanted].map(|light| light.iter().map(luminance).sum::<f64>());
    let squares: f64 = found.iter().zip(wanted).map(|(a, b)| (luminance(a) - luminance(b)).powi(2)).sum();
    let count = wanted.len().max(1) as f64;
    [(squares / count).sqrt() / (total / count), sum / total]
}

fn keep(folder: &Path, name: &str, view: &View, [found, wanted]: [&[[u8; 4]]; 2]) -> Result<()> {
    let file = |kind: &str| folder.join(format!("{}{kind}.png", name.replace([' ', '/'], "-")));
    write_png(&file(""), view.width, view.height, found)?;
    let difference = |(a, b): (&[u8; 4], &[u8; 4])| {
        let channel = |at: usize| (128 + 8 * (i32::from(a[at]) - i32::from(b[at]))).clamp(0, 255) as u8;
        [channel(0), channel(1), channel(2), 255]
    };
    let differences: Vec<[u8; 4]> = found.iter().zip(wanted).map(difference).collect();
    Ok(write_png(&file("-difference"), view.width, view.height, &differences)?)
}
