//! `kiln preview`: pictures of a bake, from a bundle or from a farm.

use std::path::PathBuf;

use clap::Args;
use lightkiln_client::fetch::Source;
use lightkiln_http::Level;

use crate::arguments::BakeArgument;
use crate::console::put_json;
use crate::edit::EditArguments;
use crate::failure::Result;
use crate::following::follow;
use crate::interrupt::Interrupt;
use crate::kinds::KindTables;
use crate::lighting::LightArguments;
use crate::outputs::check_png;
use crate::picture::PictureArguments;
use crate::reel::ReelArguments;

/// Arguments of `kiln preview`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    source: BakeArgument,
    /// Waits until a bake under way is done; without it the light that is baked by now is drawn, which is said. Ctrl-C ends the wait,
    /// not the bake
    #[arg(long, requires = "server")]
    wait: bool,
    /// Picture to write
    #[arg(long, value_name = "PNG")]
    out: PathBuf,
    #[command(flatten)]
    picture: PictureArguments,
    #[command(flatten)]
    reel: ReelArguments,
    #[command(flatten)]
    edit: EditArguments,
    /// Ends with a JSON object on standard output: files, who drew, bounces, exposure, seconds, bytes of light, work by level of detail,
    /// under_way: cells of a bake under way that are baked, and all; provisional: share of the picture's light that walks tell until an edit is baked
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    lighting: LightArguments,
}

/// Draws the picture.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    arguments.picture.check()?;
    check_png(&arguments.out)?;
    let reel = arguments.reel.read(&arguments.lighting, &kinds.client)?;
    if let Some(path) = &reel.path {
        arguments.picture.check_beside(path)?;
    }
    let source = arguments.source.open()?;
    if let (true, Source::Server { client, bake, .. }) = (arguments.wait, &source) {
        let interrupt = Interrupt::listen()?;
        follow(client, bake, &interrupt, || Ok(None))?;
        // Drawing is not wound down: the next signal ends it at once.
        interrupt.flag().raise(Level::Drain);
    }
    let Arguments { picture, lighting, out, json, edit, .. } = arguments;
    let drawn = match edit.light(kinds, &source)? {
        Some(edited) => picture.draw_edit(reel, edited, &lighting, &out)?,
        None => picture.draw_reel(reel, &kinds.client, &lighting, &source, &out)?,
    };
    if json {
        put_json(&drawn);
    }
    Ok(())
}
