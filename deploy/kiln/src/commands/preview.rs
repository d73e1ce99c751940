//! `kiln preview`: pictures of a bake, from a bundle or from a farm.

use std::path::PathBuf;

use clap::Args;
use lightkiln_client::fetch::Source;
use lightkiln_http::DiskCache;

use crate::arguments::TrustArgument;
use crate::console::say;
use crate::embedded::or_in_state;
use crate::failure::Result;
use crate::interrupt::Interrupt;
use crate::kinds::KindTables;
use crate::outputs::check_png;
use crate::picture::{PictureArguments, ReelArguments};
use crate::switched_off::SwitchedOff;

/// Arguments of `kiln preview`.
#[derive(Args, Debug)]
pub struct Arguments {
    /// Bundle folder; with --server, the id of a finished bake there
    #[arg(value_name = "BUNDLE_OR_ID")]
    bake: PathBuf,
    /// Takes the bake from the server at this URL
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    #[command(flatten)]
    trust: TrustArgument,
    /// Folder for chunks fetched from a server, from which the next picture takes them [default: chunks in the state folder]
    #[arg(long, value_name = "DIR", requires = "server")]
    cache: Option<PathBuf>,
    /// GiB that the cache folder may hold, the least recently used go first; 0 for no cache
    #[arg(long, value_name = "GIB", default_value_t = 4, value_parser = clap::value_parser!(u64).range(0..=65536), requires = "server")]
    cache_gib: u64,
    /// Picture to write
    #[arg(long, value_name = "PNG")]
    out: PathBuf,
    #[command(flatten)]
    picture: PictureArguments,
    #[command(flatten)]
    reel: ReelArguments,
    /// Ends with a JSON object on standard output: files, who drew, bounces, exposure, seconds, bytes of light
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    off: SwitchedOff,
}

/// Draws the picture.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    arguments.picture.check()?;
    check_png(&arguments.out)?;
    let reel = arguments.reel.read(arguments.off, &arguments.picture)?;
    let source = match &arguments.server {
        Some(url) => {
            let client = arguments.trust.connect(url, &Interrupt::default())?;
            let source = Source::server(client, arguments.bake.to_string_lossy());
            match arguments.cache_gib {
                0 => source,
                gib => cached(source, or_in_state(arguments.cache, "chunks").ok(), gib),
            }
        }
        None => Source::bundle(&arguments.bake)?,
    };
    let Arguments { picture, off, out, json, .. } = arguments;
    let drawn = picture.draw_reel(reel, &kinds.client, &off, &source, &out)?;
    if json {
        println!("{}", serde_json::json!(drawn));
    }
    Ok(())
}

/// The source with a cache in a folder, or without one where the folder cannot be used, which is said.
fn cached(source: Source, folder: Option<PathBuf>, gib: u64) -> Source {
    let Some(folder) = folder else {
        say!(
            "note: there is no place for a cache (neither KILN_STATE nor HOME is set): chunks are fetched each time"
        );
        return source;
    };
    match DiskCache::open(&folder, gib << 30) {
        Ok(cache) => source.with_cache(cache),
        Err(error) => {
            let folder = folder.display();
            say!("warning: the cache {folder} cannot be used ({error}): chunks are fetched each time");
            source
        }
    }
}
