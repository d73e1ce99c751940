//! Draws a bundle under one lamp: `cargo run --release -p lightkiln-client --example picture -- room.kiln room.png`.

use std::error::Error;
use std::path::Path;

use lightkiln_client::bake::LoadedBake;
use lightkiln_client::fetch::Source;
use lightkiln_client::kinds;
use lightkiln_client::lights::parse_light;
use lightkiln_client::preview::{Backend, View, render_png};

fn main() -> Result<(), Box<dyn Error>> {
    let [_, folder, png] = &std::env::args().collect::<Vec<_>>()[..] else {
        return Err("give a bundle's folder and the picture's path".into());
    };
    let bake = LoadedBake::load(&Source::bundle(folder)?, &kinds::all())?;
    // The bake's own camera; this lamp takes the place of the file's lights.
    let lamp = parse_light("point pos=0,2,0 color=1,0.9,0.8 power=100")?;
    let (view, notes) = View::of_bake(&bake, None, Some(vec![lamp]))?;
    notes.iter().for_each(|note| eprintln!("note: {note}"));
    let picture = render_png(&bake, &view, Backend::Auto, Path::new(png))?;
    println!("{} bounces, drawn by {}", picture.bounces, picture.drawn_by);
    Ok(())
}
