//! `kiln inspect`: what is in a bundle or a chunk.

use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use lightkiln_client::fetch::Source;
use lightkiln_proto::kinds::Kinds;
use serde::Serialize;

use crate::console::{printable, put, put_json};
use crate::failure::{Failure, Result};
use crate::inspection::{BundleFigures, ChunkFigures};

/// Arguments of `kiln inspect`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Bundle folder, or one chunk's file in it
    #[arg(value_name = "BUNDLE_OR_CHUNK")]
    path: PathBuf,
    /// Prints the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Prints figures for people or as JSON.
pub fn run(arguments: Arguments, kinds: &Kinds) -> Result<()> {
    if arguments.path.is_dir() {
        let (_, manifest) = Source::bundle(&arguments.path)?.manifest()?;
        let figures = BundleFigures::of(kinds, &manifest).map_err(|error| {
            Failure::bad_input(format!("{} cannot be read", arguments.path.display())).caused_by(&error)
        })?;
        print(&figures, arguments.json);
    } else {
        print(&read_chunk(kinds, &arguments.path)?, arguments.json);
    }
    Ok(())
}

fn read_chunk(kinds: &Kinds, path: &Path) -> Result<ChunkFigures> {
    let failed = |what: &str| Failure::bad_input(format!("{} {what}", path.display()));
    let bytes = fs::read(path).map_err(|error| {
        failed("cannot be read")
            .caused_by(&error)
            .try_this("the folder that 'kiln bake --out' wrote, or a file of its chunks")
    })?;
    ChunkFigures::of(kinds, &bytes).map_err(|error| failed("is no chunk that can be read").caused_by(&error))
}

fn print(figures: &(impl Display + Serialize), json: bool) {
    if json {
        put_json(&figures);
    } else {
        put(&printable(&figures.to_string()));
    }
}
