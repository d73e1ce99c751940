//! `kiln view`: a window on a bake, from a bundle or from a farm.

use std::path::PathBuf;

use clap::Args;
use lightkiln_client::bake::MeasuredErrors;
use lightkiln_client::preview::View;
use lightkiln_client::view::{self, Options};

use crate::arguments::BakeArgument;
use crate::console::say;
use crate::failure::Result;
use crate::kinds::KindTables;
use crate::lighting::LightArguments;
use crate::objects::{ObjectArgument, parse_object};
use crate::outputs::check_png;
use crate::picture::LookArguments;
use crate::reel::parse_bytes;

/// Arguments of `kiln view`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    source: BakeArgument,
    #[command(flatten)]
    look: LookArguments,
    /// Object beside the bake, which the panel moves: "FILE [pos=x,y,z] [turn=yaw,pitch,roll] [scale=s] [time=seconds] [clip=n]
    /// [swing=yaw,pitch,roll] [hinge=x,y,z]",
    /// as of 'kiln preview'; may be given often
    #[arg(long, value_name = "OBJECT", value_parser = parse_object, help_heading = "Picture")]
    object: Vec<ObjectArgument>,
    /// Lets light take at most so much memory, about, as the bake's directory tells it, e.g. 200M: clusters that the view needs least
    /// go back to fewer layers, or to the overview, and come again when it needs them [default: as much as all of it takes]
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, help_heading = "Picture")]
    max_memory: Option<u64>,
    /// Shows errors at first, of a file that 'kiln evaluate --dump' wrote: each texel as the nearest measured place, red where light is
    /// too bright, blue where it is too dark
    #[arg(long, value_name = "FILE.csv", help_heading = "Window")]
    errors: Option<PathBuf>,
    /// Opens the window without the panel, which F1 shows
    #[arg(long, help_heading = "Window")]
    no_panel: bool,
    /// Closes the window after so many pictures, each with a bounce more until light has settled, or as soon after them as the
    /// picture is whole; those before all light has come from a server do not count, and a server that is lost is an error
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = "Window")]
    frames: Option<u64>,
    /// Writes the last picture when the window closes, without the panel
    #[arg(long, value_name = "PNG", help_heading = "Window")]
    screenshot: Option<PathBuf>,
    #[command(flatten)]
    lighting: LightArguments,
}

/// Opens the window, until it is closed.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    let Arguments { source, look, object, max_memory, errors, no_panel, frames, screenshot, lighting } =
        arguments;
    look.check()?;
    screenshot.as_deref().map_or(Ok(()), check_png)?;
    let errors = errors.as_deref().map(MeasuredErrors::read).transpose()?;
    let beside = |object: &ObjectArgument| object.beside(&kinds.client);
    let objects = object.iter().map(beside).collect::<Result<_>>()?;
    let (subject, view, notes) =
        look.opened(&source.open()?, &kinds.client, &lighting, objects, max_memory)?;
    let view = View { objects: object.iter().map(|object| object.stance).collect(), ..view };
    for note in &notes {
        say!("note: {note}");
    }
    let materials = look.colours().to_vec();
    let bake_words = source.words();
    let memory = max_memory.unwrap_or(u64::MAX);
    let has_panel = !no_panel;
    let options =
        Options { view, materials, errors, bake_words, notes, has_panel, memory, frames, screenshot };
    Ok(view::run(subject, options)?)
}
