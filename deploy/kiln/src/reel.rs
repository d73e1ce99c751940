//! Pictures along a path, with objects that move, of as much light as is asked for.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use lightkiln_client::bake::{Beside, ClientKinds, LoadedBake};
use lightkiln_client::lights::ParsedLights;
use lightkiln_client::picture::PassTime;
use lightkiln_client::preview::{PATH_FILE_MAX, ProbeColours, ViewPath, Walks, probe_edges, probe_spheres};
use lightkiln_client::scene::Stance;
use lightkiln_client::stream::{Baked, Budget, Streamed};
use lightkiln_proto::relight::LevelCount;
use serde::Serialize;

use crate::failure::{Failure, Result};
use crate::lighting::LightArguments;
use crate::objects::{ObjectArgument, parse_object};

/// Parts of a bake that can be drawn into its scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ShowName {
    /// Probes in free space: white spheres in the light that they have, which cast shadows
    Probes,
    /// Probes coloured by their depth maps: red towards what is near, over yellow to blue from twice their distance from each other on
    Depth,
    /// Probes coloured by component, probes that see each other by way of others: white the one with most, another colour for each room that
    /// is closed
    Components,
    /// Edges between probes, along which light is told: green ones, and red ones that a surface cuts, whose light depth maps stop
    Edges,
    /// Surfaces as walks through voxels meet them from the eye, without any mesh; of bakes with voxels=on
    Elements,
    /// Surfaces whose indirect light is that of 64 walks through voxels instead of the lightmap's; of bakes with voxels=on
    Walks,
}

/// How much light to fetch, and how many pictures to draw of it.
#[derive(Args, Clone, Debug, Default)]
pub struct ReelArguments {
    /// Fetches at most so many bytes of light, e.g. 500k or 2M: the overview first, then what the picture needs most
    /// [default: all]
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, help_heading = "Picture")]
    max_bytes: Option<u64>,
    /// Lets light take at most so much memory, about, as the bake's directory tells it, e.g. 200M: of clusters that the picture needs
    /// least fewer layers are drawn, or the overview [default: as much as all of it takes]
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, help_heading = "Picture")]
    max_memory: Option<u64>,
    /// Draws many pictures along a path, NAME-0001.png and on: a JSON file {"keys": [{"picture": 1, "camera": "eye=…",
    /// "lights": ["point pos=…"], "objects": ["pos=… turn=…"]}, {"picture": 60, …}]}, between whose keys camera, lights
    /// and objects move evenly. The exposure of the first picture that is not black is that of all; --max-bytes and
    /// --max-memory choose light for the first one
    #[arg(long, value_name = "FILE", conflicts_with = "debug", help_heading = "Picture")]
    path: Option<PathBuf>,
    /// Object beside the bake, which moves: "FILE [pos=x,y,z] [turn=yaw,pitch,roll] [scale=s] [time=seconds] [clip=n]
    /// [swing=yaw,pitch,roll] [hinge=x,y,z]", a
    /// glTF, turned in degrees, at a time of its n-th animation; may be given often. Lights light it, and bounced light where the bake
    /// has it in free space; it casts shadows on all that lights reach, from where less light bounces
    #[arg(long, value_name = "OBJECT", value_parser = parse_object, help_heading = "Picture")]
    object: Vec<ObjectArgument>,
    /// Draws into the scene what the bake is made of, of kinds that have it
    #[arg(
        long,
        value_enum,
        value_name = "WHAT",
        conflicts_with_all = ["debug", "path", "max_bytes", "max_memory"],
        help_heading = "Picture"
    )]
    show: Option<ShowName>,
}

/// Pictures to draw of a bake.
#[derive(Debug, Default)]
pub struct Reel {
    /// Bounds of the light to fetch; all without.
    pub budget: Option<Budget>,
    /// Keys of pictures; one picture without.
    pub path: Option<ViewPath>,
    /// Parts of the bake to be drawn too.
    show: Option<ShowName>,
    objects: Vec<(Beside, Stance)>,
}

impl Reel {
    /// One picture with objects, of all light.
    pub fn of_objects(objects: &[ObjectArgument], kinds: &ClientKinds) -> Result<Self> {
        let read = |object: &ObjectArgument| Ok((object.beside(kinds)?, object.stance));
        let objects = objects.iter().map(read).collect::<Result<_>>()?;
        Ok(Self { objects, ..Self::default() })
    }

    /// Takes its objects, and their stances.
    pub fn take_objects(&mut self) -> (Vec<Beside>, Vec<Stance>) {
        std::mem::take(&mut self.objects).into_iter().unzip()
    }

    /// Puts the parts that are to be shown of a bake into it, beside objects with these stances.
    pub fn show_in(&self, bake: &mut LoadedBake, stances: &mut Vec<Stance>) -> Result<()> {
        let shown = match self.show {
            None | Some(ShowName::Elements | ShowName::Walks) => return Ok(()),
            Some(ShowName::Probes) => probe_spheres(bake, ProbeColours::White)?,
            Some(ShowName::Depth) => probe_spheres(bake, ProbeColours::Depth)?,
            Some(ShowName::Components) => probe_spheres(bake, ProbeColours::Components)?,
            Some(ShowName::Edges) => probe_edges(bake)?,
        };
        bake.add_object(shown)?;
        stances.push(Stance::default());
        Ok(())
    }

    /// Pictures made by walks through voxels.
    pub fn walks(&self) -> Walks {
        let eye = self.show == Some(ShowName::Elements);
        Walks { eye, irradiance: self.show == Some(ShowName::Walks), ..Walks::default() }
    }

    /// Refuses to show what a part of a bake is made of.
    pub fn check_part(&self) -> Result<()> {
        if self.show.is_none() {
            return Ok(());
        }
        let what = "--show needs the whole light, and this bake goes on";
        Err(Failure::bad_input(what).try_this("it once the bake is done"))
    }
}

impl ReelArguments {
    /// Reads path and objects, before any light is fetched.
    pub fn read(&self, lighting: &LightArguments, kinds: &ClientKinds) -> Result<Reel> {
        let path = self.path(lighting)?;
        let placed = path.as_ref().and_then(ViewPath::objects);
        if let Some(placed) = placed.filter(|placed| *placed != self.object.len()) {
            let given = self.object.len();
            return Err(Failure::bad_input(format!(
                "the keys of the path place {placed} objects, and {given} are given"
            ))
            .try_this("--object FILE once for each, in the order of the keys"));
        }
        let Reel { objects, .. } = Reel::of_objects(&self.object, kinds)?;
        let is_bounded = self.max_bytes.is_some() || self.max_memory.is_some();
        let bounded = Budget {
            bytes: self.max_bytes.unwrap_or(u64::MAX),
            memory: self.max_memory.unwrap_or(u64::MAX),
            ..Budget::NONE
        };
        Ok(Reel { budget: is_bounded.then_some(bounded), path, objects, show: self.show })
    }

    /// The path, if there is one, without what is switched off; refuses a file that holds none.
    fn path(&self, lighting: &LightArguments) -> Result<Option<ViewPath>> {
        let Some(file) = &self.path else { return Ok(None) };
        let refused = |problem: &str| Failure::bad_input(format!("{} {problem}", file.display()));
        let failed = |error: std::io::Error| refused("cannot be read").caused_by(&error);
        let mut json = Vec::new();
        let opened = File::open(file).map_err(failed)?;
        opened.take(PATH_FILE_MAX + 1).read_to_end(&mut json).map_err(failed)?;
        if json.len() as u64 > PATH_FILE_MAX {
            return Err(refused(&format!("has more than the {PATH_FILE_MAX} bytes of a path")));
        }
        let path =
            ViewPath::parse(&json).map_err(|error| refused("is no path of pictures").caused_by(&error))?;
        Ok(Some(path.with_lights(|ParsedLights { lights, emitter_scale }| ParsedLights {
            lights: lighting.rest(lights),
            emitter_scale: emitter_scale.map(|scale| lighting.emitter_scale(scale)),
        })))
    }
}

/// Pictures that were drawn.
#[derive(Debug, Default, Serialize)]
pub struct Drawn {
    /// Files in the order of the path.
    pub pictures: Vec<String>,
    /// Adapter or processor that drew the last one, with the reason.
    pub drawn_by: String,
    /// Most bounces before a picture.
    pub bounces: u32,
    /// Whether they had converged by then, in all pictures.
    pub converged: bool,
    /// Factor on radiance before tone mapping.
    pub exposure: f32,
    /// Time of the adapter's passes, by its own clock; none where it has no clock, and of the processor.
    pub passes: Option<Vec<PassRow>>,
    /// Work by level of detail in the last picture, the finest first; none where there is all detail.
    pub lod: Option<Vec<LevelCount>>,
    /// Seconds from the light at hand to the last file.
    pub seconds: f64,
    /// Bytes of light that were fetched.
    pub light_bytes: Option<u64>,
    /// Bytes of all.
    pub light_bytes_all: Option<u64>,
    /// Memory that the light takes when it is lit, about.
    pub light_memory: Option<u64>,
    /// Why less light was drawn than was asked for.
    pub less_light: Option<String>,
    /// Cells of a bake under way whose light is baked, and all of its cells; none of a bake that is done.
    pub under_way: Option<Baked>,
    /// Share of the light in the picture, of a path in the first one, that walks tell until an edit is baked, 0 to 1; none without an edit.
    pub provisional: Option<f32>,
}

/// Time of a pass of the adapter.
#[derive(Clone, Debug, Serialize)]
pub struct PassRow {
    /// Name of the pass.
    pub pass: &'static str,
    /// Runs of it for all pictures.
    pub runs: u64,
    /// Milliseconds of a run, the mean.
    pub mean_ms: f64,
}

impl PassRow {
    /// A pass' time as it is told.
    pub fn of(time: &PassTime) -> Self {
        Self { pass: time.name, runs: time.runs, mean_ms: time.total_ms / time.runs.max(1) as f64 }
    }
}

/// Light that has come, in words.
pub fn worded_part(come: &Streamed) -> String {
    let Streamed { bytes, bytes_all, clusters, whole, clusters_all, lost, .. } = come;
    let mut of_clusters = format!("{clusters} of {clusters_all} clusters, {whole} of them with all layers");
    if *lost > 0 {
        of_clusters += &format!(", {lost} lost by the server until they are baked again");
    }
    let Some(Baked { cells, cells_all }) = come.baked else {
        let percent = 100.0 * *bytes as f64 / (*bytes_all).max(1) as f64;
        return format!(
            "{bytes} of {bytes_all} bytes of light ({percent:.1} %): the overview, and {of_clusters}"
        );
    };
    format!(
        "the bake goes on, {cells} of {cells_all} cells are baked: {bytes} bytes of light, {of_clusters}; elsewhere lights shine directly alone ('kiln preview --wait' waits for the rest)"
    )
}

/// Bytes as people write them: a number, with k, M or G for powers of 1000.
pub fn parse_bytes(text: &str) -> std::result::Result<u64, String> {
    let wrong = || format!("'{text}' is no number of bytes; write e.g. 500k, 2M or 1500000");
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let scale = match &text[digits.len()..] {
        "" => 1.0,
        "k" => 1e3,
        "M" => 1e6,
        "G" => 1e9,
        _ => return Err(wrong()),
    };
    let number: f64 = digits.parse().map_err(|_| wrong())?;
    let bytes = number * scale;
    if (1.0..=1e15).contains(&bytes) { Ok(bytes as u64) } else { Err(wrong()) }
}

/// The file of a picture along a path: `NAME-0001.png`.
pub fn numbered(png: &Path, number: usize) -> PathBuf {
    let mut name = png.file_stem().unwrap_or_default().to_owned();
    name.push(format!("-{number:04}."));
    name.push(png.extension().unwrap_or_default());
    png.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_clusters_of_a_bake_under_way_are_said() {
        let come = Streamed { clusters: 3, clusters_all: 5, whole: 3, ..Streamed::default() };
        let baked = Some(Baked { cells: 2, cells_all: 4 });
        let lost = worded_part(&Streamed { lost: 2, baked, ..come });
        assert!(lost.contains("2 of 4 cells") && lost.contains("2 lost by the server"), "{lost}");
        assert!(!worded_part(&Streamed { baked, ..come }).contains("lost"));
    }

    #[test]
    fn bytes_are_numbers_with_a_power_of_a_thousand() {
        let read = ["1500", "500k", "2M", "1.5G"].map(parse_bytes);
        assert_eq!(read, [Ok(1500), Ok(500_000), Ok(2_000_000), Ok(1_500_000_000)]);
        for wrong in ["", "k", "-1", "0", "NaN", "inf", "2MB", "2 M", "1e40"] {
            assert!(parse_bytes(wrong).is_err(), "{wrong}");
        }
    }
}
