//! Arguments of an evaluation: lights, precision, limits.

use std::fs;
use std::path::PathBuf;

use clap::{Args, ValueEnum};
use lightkiln_worker::evaluate::{PIXEL_CLASSES, TestLight, lights_of_file};
use lightkiln_worker::kinds::BakeKinds;

use super::limits::Limit;
use super::objects::OBJECT_FIGURES;
use crate::failure::{Failure, Result};

/// Strata of the sample of which one is measured at its pixel too.
const PIXELS_SHARE: u32 = 3;

/// Where a bake is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Where {
    /// On surfaces
    #[default]
    Surfaces,
    /// In free space, where objects move
    Space,
    /// On surfaces, by walks through voxels instead of the lightmap
    Walks,
}

/// Arguments that `kiln evaluate` and `kiln bake --evaluate` share.
#[derive(Args, Clone, Debug)]
pub struct EvaluationArguments {
    /// Lights to measure with, as JSON: {"lights": [{"name": "lamp", "type": "point", "position_m": [0, 2, 0], "strength":
    /// [10, 9, 8]}]}; types are point, spot, sun, rect, sky and emitters [default: chosen from the scene, and said]
    #[arg(long, value_name = "FILE", help_heading = "Evaluation")]
    pub lights: Option<PathBuf>,
    /// Standard error of the reference over the mean, or over the geometric mean of it and the value where that is brighter;
    /// places that stand for little area may have more. Smaller takes longer, with its inverse square
    #[arg(long, value_name = "E", default_value_t = 0.03, value_parser = parse_rel_error, help_heading = "Evaluation")]
    pub rel_error: f64,
    /// Where to measure: on surfaces, or in free space, half of the places within 50 cm of surfaces, each in two opposite
    /// directions; of bakes of a kind with light there
    #[arg(long = "in", value_enum, default_value_t, value_name = "WHERE", help_heading = "Evaluation")]
    pub place: Where,
    /// Places to measure at, spread by area, and denser where there is more light or it changes faster
    #[arg(
        long,
        value_name = "N",
        default_value_t = 2000,
        value_parser = clap::value_parser!(u32).range(10..=1_000_000),
        help_heading = "Evaluation"
    )]
    pub receivers: u32,
    /// Places of those that are also measured as pictures show them: at points of surfaces, by the client's shadow maps, with
    /// seams and texels that stand out; 0 for none [default: a third of --receivers]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1_000_000), help_heading = "Evaluation")]
    pub pixels: Option<u32>,
    /// Fails with exit code 4 when a figure is so at both ends of its 95 % interval, e.g. rel_rmse>0.08,
    /// energy_ratio<0.97, sun.p95>0.3; warns when at one; may be given often
    #[arg(long, value_name = "EXPR", help_heading = "Evaluation")]
    pub fail_if: Vec<Limit>,
}

impl EvaluationArguments {
    /// Number of pixels to measure at.
    pub fn pixels(&self) -> u32 {
        match self.place {
            Where::Surfaces => self.pixels.unwrap_or(self.receivers / PIXELS_SHARE),
            // No picture shows free space, or E_ind by walks.
            Where::Space | Where::Walks => 0,
        }
    }

    /// Errs when a limit names neither a figure nor a class of error of some kind of bake; cheap, as [`Self::own_lights`].
    pub fn check_figures(&self, kinds: &BakeKinds) -> Result<()> {
        let classes = [kinds.error_classes(), PIXEL_CLASSES.into()].concat();
        self.fail_if.iter().try_for_each(|limit| limit.check_figure(&classes))
    }

    /// The same of figures of objects.
    pub fn check_object_figures(&self) -> Result<()> {
        self.fail_if.iter().try_for_each(|limit| limit.check_among(&OBJECT_FIGURES))
    }

    /// Errs where a bake of that kind has nothing at the place, --pixels asks for what no picture shows, or --lights for light that it cannot have;
    /// cheap, as [`Self::own_lights`].
    pub fn check_place(&self, kinds: &BakeKinds, kind: &str) -> Result<()> {
        if self.lights.is_some() && kinds.get(kind).is_some_and(|kind| !kind.is_relightable()) {
            return Err(not_relightable(kind));
        }
        let has_pixels = self.pixels.is_some_and(|pixels| pixels > 0);
        if has_pixels && kinds.get(kind).is_some_and(|kind| !kind.has_lightmap()) {
            let what = format!("--pixels reads lightmaps, and bakes of kind '{kind}' have none");
            return Err(Failure::bad_input(what).try_this("leave out --pixels"));
        }
        if self.place == Where::Surfaces {
            return Ok(());
        }
        if has_pixels {
            let what = "--pixels asks for pictures, which show neither free space nor light by walks";
            return Err(Failure::bad_input(what).try_this("--in surfaces, or no --pixels"));
        }
        // Whether there are voxels the bake's settings say, not its kind.
        if self.place == Where::Walks {
            return Ok(());
        }
        // A kind that is none is said elsewhere.
        if kinds.get(kind).is_none_or(|kind| kind.has_space()) {
            return Ok(());
        }
        Err(without_space(kind))
    }

    /// The lights of --lights; cheap, so that a wrong file is said before anything is baked or prepared.
    pub fn own_lights(&self) -> Result<Option<Vec<TestLight>>> {
        let Some(path) = &self.lights else { return Ok(None) };
        let failed = |problem: &str, error: &(dyn std::error::Error + 'static)| {
            Failure::bad_input(format!("{} {problem}", path.display())).caused_by(error)
        };
        let json = fs::read(path).map_err(|error| failed("cannot be read", &error))?;
        lights_of_file(&json).map(Some).map_err(|error| failed("cannot be measured with", &error))
    }
}

/// A bake of that kind can be measured under no light but its own.
pub fn not_relightable(kind: &str) -> Failure {
    let what = format!(
        "a bake of kind '{kind}' has the light that it was baked with, and can be measured under no other"
    );
    Failure::bad_input(what)
        .try_this("leave out --lights, --sky and switches of lights, or bake another kind")
}

/// A bake of that kind has nothing to measure in free space.
pub fn without_space(kind: &str) -> Failure {
    Failure::bad_input(format!("bakes of kind '{kind}' have no light in free space"))
        .try_this("--in surfaces")
}

/// A bake has no voxels to walk through.
pub fn without_voxels() -> Failure {
    Failure::bad_input("the bake has no voxels").try_this("bake it with --set voxels=on, or --in surfaces")
}

fn parse_rel_error(text: &str) -> std::result::Result<f64, String> {
    match text.parse() {
        Ok(value @ 0.0005..=1.0) => Ok(value),
        _ => Err("write a number in 0.0005..=1, e.g. 0.03".to_owned()),
    }
}
