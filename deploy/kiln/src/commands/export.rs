//! `kiln export`: a bake's light, frozen under chosen lights, for engines that do not know Lightkiln.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use lightkiln_client::bake::LoadedBake;
use lightkiln_client::export::{self, Exported, Options, ProbeFormat, Share};
use lightkiln_client::lights::{ParsedLights, lights_of, parse_lights};
use lightkiln_client::preview::{LitReceivers, light_receivers};
use lightkiln_client::scene::{Recolour, check_recolours};
use serde_json::json;

use crate::arguments::BakeArgument;
use crate::console::{put_json, say};
use crate::failure::Result;
use crate::kinds::KindTables;
use crate::lighting::LightArguments;
use crate::outputs::{check_folder, folder_of};
use crate::picture::{BackendName, parse_recolour};

/// Arguments of `kiln export`.
#[derive(Args, Debug)]
pub struct Arguments {
    #[command(flatten)]
    source: BakeArgument,
    /// Folder to write: scene.glb, lightmap-0.ktx2 and on, and light in free space, which it names
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Light instead of the scene's own, as of 'kiln preview'; may be given often
    #[arg(long, visible_alias = "lights", value_name = "LIGHT")]
    light: Vec<String>,
    /// Another base colour of a material, linear, as of 'kiln preview'; may be given often
    #[arg(long, value_name = "MATERIAL", value_parser = parse_recolour)]
    material: Vec<Recolour>,
    /// Light that the pages hold
    #[arg(long, value_enum, default_value = "all")]
    irradiance: ShareName,
    /// Texels of a page along each of the lightmap's, 1 or 3: with 3, light keeps to its side of walls thinner than a texel, at
    /// nine times the texels
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = parse_scale)]
    scale: u32,
    /// Light in free space, for objects that move; may be given often [default: all, of bakes that have it]
    #[arg(long, value_enum, value_name = "FORMAT")]
    probes: Vec<ProbesName>,
    /// Who settles the light; auto takes the graphics adapter if there is one that is no software
    #[arg(long, value_enum, default_value = "auto")]
    backend: BackendName,
    /// Ends with a JSON object on standard output: files, pages, intensity, who lit it, bounces, seconds, warnings
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    lighting: LightArguments,
}

/// Light that pages hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ShareName {
    /// Direct and indirect, as engines expect of static lights: they add none of their own
    All,
    /// Bounces, emissive surfaces and skies; the engine adds the direct light of points, spots and suns
    Indirect,
}

/// Files of light in free space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ProbesName {
    /// Ambient cubes in a volume: Bevy
    Cube,
    /// Places and spherical harmonics: Unity
    Unity,
    /// Octahedral maps of irradiance and of distances: shaders of dynamic diffuse global illumination
    Ddgi,
    /// Spherical harmonics at the corners of tetrahedra: Godot
    Godot,
}

/// Writes the export.
pub fn run(arguments: Arguments, kinds: &KindTables) -> Result<()> {
    let start = Instant::now();
    let ParsedLights { lights, emitter_scale } = parse_lights(&arguments.light)?;
    export::check_folder(&arguments.out)?;
    // The export is written beside its place first.
    check_folder(folder_of(&arguments.out))?;
    let source = arguments.source.open()?;
    if !arguments.material.is_empty() {
        check_recolours(&source.manifest()?.1, &arguments.material)?;
    }
    let mut bake = LoadedBake::load(&source, &kinds.client)?;
    bake.recolour(&arguments.material)?;
    arguments.lighting.tell_of_light_that_stays(&bake, !arguments.light.is_empty());
    let lights = if arguments.light.is_empty() {
        let (own, note) = lights_of(&bake.scene.manifest);
        note.iter().for_each(|note| say!("note: {note}"));
        own
    } else {
        lights
    };
    let scale = arguments.lighting.emitter_scale(emitter_scale.unwrap_or(1.0));
    let emitters = vec![scale; bake.scene.manifest.emitters.len()];
    let lights = arguments.lighting.rest(lights);
    let panorama = arguments.lighting.panorama()?;
    let files = export::texture_files(&source, &bake)?;
    export::check(&bake, &files, arguments.scale)?;
    let mut probes: Vec<ProbeFormat> = arguments.probes.iter().copied().map(Into::into).collect();
    if probes.is_empty() {
        probes.extend(ProbeFormat::ALL);
    } else {
        export::check_probes(&bake)?;
    }
    let lit = light_receivers(&bake, lights, panorama, emitters.clone(), arguments.backend.into())?;
    let options = Options { share: arguments.irradiance.into(), scale: arguments.scale, probes: &probes };
    let mut exported = export::export(&bake, &files, &lit.settled.light, &emitters, options)?;
    exported.warnings.extend(bake.scene.warnings.iter().cloned());
    export::write(&exported, &arguments.out)?;
    tell(&exported, &lit, &arguments.out, start);
    if arguments.json {
        put_json(&summary(&exported, &lit, &arguments.out, start));
    }
    Ok(())
}

/// Says on standard error what was written, and what is missing from it.
fn tell(exported: &Exported, lit: &LitReceivers, out: &Path, start: Instant) {
    let bytes: usize = exported.files.iter().map(|(_, bytes)| bytes.len()).sum();
    for warning in &exported.warnings {
        say!("warning: {warning}");
    }
    if !lit.settled.converged {
        let bounces = lit.settled.bounces;
        say!("warning: after {bounces} bounces the light had not converged; more of them would change it");
    }
    let (files, seconds) = (exported.files.len(), start.elapsed().as_secs_f64());
    say!("lit by {}", lit.lit_by);
    say!("{}: {files} files, {bytes} bytes, in {seconds:.1} s", out.display());
}

fn summary(exported: &Exported, lit: &LitReceivers, out: &Path, start: Instant) -> serde_json::Value {
    let file = |(name, bytes): &(String, Vec<u8>)| json!({ "path": out.join(name).display().to_string(), "bytes": bytes.len() });
    json!({
        "files": exported.files.iter().map(file).collect::<Vec<_>>(),
        "pages": exported.pages,
        "intensity": exported.intensity,
        "lit_by": lit.lit_by,
        "bounces": lit.settled.bounces,
        "converged": lit.settled.converged,
        "seconds": start.elapsed().as_secs_f64(),
        "warnings": exported.warnings,
    })
}

impl From<ShareName> for Share {
    fn from(name: ShareName) -> Self {
        match name {
            ShareName::All => Self::All,
            ShareName::Indirect => Self::Indirect,
        }
    }
}

impl From<ProbesName> for ProbeFormat {
    fn from(name: ProbesName) -> Self {
        match name {
            ProbesName::Cube => Self::Cube,
            ProbesName::Unity => Self::Unity,
            ProbesName::Ddgi => Self::Ddgi,
            ProbesName::Godot => Self::Godot,
        }
    }
}

fn parse_scale(text: &str) -> std::result::Result<u32, String> {
    match text.parse() {
        Ok(scale) if export::SCALES.contains(&scale) => Ok(scale),
        _ => Err("write 1 or 3".to_owned()),
    }
}
