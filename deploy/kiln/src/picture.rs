//! A picture of a bake, as the command line asks for it.

mod words;

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, ValueEnum};
use lightkiln_client::ClientError;
#[cfg(feature = "view")]
use lightkiln_client::bake::check_colours;
use lightkiln_client::bake::{Beside, ClientKinds, Edited, LoadedBake, share_colours};
use lightkiln_client::fetch::Source;
use lightkiln_client::lights::{ParsedLights, parse_camera, parse_lights};
use lightkiln_client::picture::{Exposure, Picture, Tone};
use lightkiln_client::preview::{
    Backend, Fog, StreamedBake, SurfaceDetails, View, ViewPath, Walks, debug_picture, provisional_share,
    render, render_path,
};
use lightkiln_client::scene::{Recolour, Stance};
use lightkiln_client::stream::{Budget, Streamed};
#[cfg(feature = "view")]
use lightkiln_client::view::Subject;
use lightkiln_proto::manifest::Manifest;
#[cfg(feature = "view")]
use lightkiln_proto::manifest::OVERVIEW;
use lightkiln_proto::relight::{LevelCount, Lod};

use crate::console::say;
use crate::failure::{Failure, Result};
use crate::lighting::LightArguments;
use crate::reel::{Drawn, PassRow, Reel, numbered, parse_bytes, worded_part};

use words::{parse_fog, parse_lod, parse_stops};
pub use words::{parse_recolour, parse_size};

/// The picture to draw, and how it looks.
#[derive(Args, Clone, Debug)]
pub struct LookArguments {
    /// Camera of the picture, e.g. "eye=0,1.6,4 target=0,1,0 fov=50" (metres, degrees) [default: the scene's first,
    /// else one is chosen and said]
    #[arg(long, value_name = "CAMERA", help_heading = "Picture")]
    camera: Option<String>,
    /// Light of the picture instead of the scene's own; may be given often:
    /// "point pos=x,y,z color=r,g,b power=W",
    /// "spot pos=x,y,z target=x,y,z color=r,g,b power=W inner=deg outer=deg",
    /// "sun dir=x,y,z color=r,g,b irradiance=W/m2", "sky zenith=r,g,b horizon=r,g,b strength=s",
    /// "rect pos=x,y,z target=x,y,z size=w,h color=r,g,b power=W up=x,y,z points=n", which shines evenly from its front,
    /// "emitters scale=s" (the scene's emissive surfaces, 1 unless said)
    #[arg(long, value_name = "LIGHT", help_heading = "Picture")]
    light: Vec<String>,
    /// Another base colour of a material, linear, instead of the file's factor: "NAME=r,g,b" with channels 0 to 1; may be
    /// given often. All light follows, and nothing is baked again. Materials are the bake's, and those of objects with bakes of their own
    #[arg(long, value_name = "MATERIAL", value_parser = parse_recolour, help_heading = "Picture")]
    material: Vec<Recolour>,
    /// Fog between surfaces, e.g. "density=0.05 albedo=0.9 g=0.3 height=2": share of light that it stops per metre, share of it that it scatters,
    /// mean cosine by which it turns light, metres of height over which it thins by a factor of e. It shows the shafts of lights, and the
    /// light of probes where the bake has some; surfaces are lit as without it
    #[arg(long, value_name = "FOG", value_parser = parse_fog, help_heading = "Picture")]
    fog: Option<Fog>,
    /// Ambient occlusion within so many metres: bounced light is less where walks through voxels meet something near. Of bakes with
    /// voxels=on
    #[arg(long, value_name = "METRES", help_heading = "Picture")]
    ao: Option<f32>,
    /// Normal maps of materials; off shows the surfaces that light is baked for, as the path tracer has them
    #[arg(long, value_enum, default_value = "on", value_name = "SHOWN", help_heading = "Picture")]
    normal_maps: Shown,
    /// Specular reflection by metallic and roughness of materials; off shows all surfaces as diffuse, as the path tracer has them
    #[arg(long, value_enum, default_value = "on", value_name = "SHOWN", help_heading = "Picture")]
    specular: Shown,
    /// Levels of detail by distance and view, for bakes of many receivers: "fine", "balanced", "coarse", or words, as
    /// "balanced level1=0.2,3,16,1,2 behind=8": where a level begins (in scene diagonals, or metres as 20m), tree level of its columns, rank,
    /// level of its receivers (0 all, 1 a quarter, …), bounces from one update to the next [default: all detail]
    #[arg(long, value_name = "DETAIL", value_parser = parse_lod, help_heading = "Picture")]
    lod: Option<Lod>,
    /// Takes at most so much of the graphics adapter's memory, e.g. 2G, as where other programs need the rest: of light that there is no
    /// room for less is drawn, as little as the overview, which is said; --backend auto leaves such bakes to the processor,
    /// and the panel of a window takes a few MB more
    /// [default: as much as the adapter gives]
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, help_heading = "Picture")]
    adapter_memory: Option<u64>,
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = parse_size, help_heading = "Picture")]
    size: (u32, u32),
    /// Curve from radiance to brightness
    #[arg(long, value_enum, default_value = "filmic", help_heading = "Picture")]
    tone: ToneName,
    /// Exposure in stops above the automatic one, e.g. -1
    #[arg(
        long,
        value_name = "STOPS",
        default_value_t = 0.0,
        value_parser = parse_stops,
        allow_negative_numbers = true,
        help_heading = "Picture"
    )]
    exposure: f32,
}

/// How to draw a picture into a file.
#[derive(Args, Clone, Debug)]
pub struct PictureArguments {
    #[command(flatten)]
    look: LookArguments,
    /// Who draws; auto takes the graphics adapter if there is one that is no software
    #[arg(long, value_enum, default_value = "auto", help_heading = "Picture")]
    backend: BackendName,
    /// Draws another picture than the scene, to find faults: of lightmaps, 'atlas' (irradiance) or 'clusters'
    #[arg(long, value_name = "PICTURE", help_heading = "Picture")]
    debug: Option<String>,
    /// Page of --debug
    #[arg(long, default_value_t = 0, requires = "debug", help_heading = "Picture")]
    page: usize,
}

/// Parts of a picture that can be left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Shown {
    /// Shown
    On,
    /// Left out
    Off,
}

/// Tone curves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ToneName {
    /// Reinhard's, soft in the lights
    Reinhard,
    /// Filmic, with contrast
    Filmic,
    /// None: exposure alone, cut off at white
    #[value(alias = "linear")]
    Exposure,
}

/// Who draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BackendName {
    /// The graphics adapter if there is one that can, else the processor, which is faster than an adapter in software
    Auto,
    /// The graphics adapter or nothing
    Gpu,
    /// The processor
    Cpu,
}

impl LookArguments {
    /// Refuses a camera or light that cannot be read, before any work is done.
    pub fn check(&self) -> Result<()> {
        self.camera.as_deref().map(parse_camera).transpose()?;
        parse_lights(&self.light)?;
        Ok(())
    }

    /// The view of a bake, and notes on what was chosen.
    fn view(
        &self,
        bake: &LoadedBake,
        lighting: &LightArguments,
        path: Option<&ViewPath>,
    ) -> Result<(View, Vec<String>)> {
        let camera = self.camera.as_deref().map(parse_camera).transpose()?;
        let camera = camera.or_else(|| path?.first_camera().cloned());
        let ParsedLights { lights, emitter_scale } = parse_lights(&self.light)?;
        lighting.tell_of_light_that_stays(bake, !self.light.is_empty());
        let own = (!self.light.is_empty()).then_some(lights);
        let own = own.or_else(|| Some(path?.first_lights()?.to_vec()));
        let (mut view, mut notes) = View::of_bake(bake, camera, own)?;
        let scale = lighting.emitter_scale(emitter_scale.unwrap_or(1.0));
        view.emitter_scale = vec![scale; bake.scene.manifest.emitters.len()];
        view.lights = lighting.rest(view.lights);
        view.panorama = lighting.panorama()?;
        (view.width, view.height) = self.size;
        view.tone = self.tone.into();
        view.exposure = Exposure::Auto { stops: self.exposure };
        view.fog = self.fog;
        view.walks.occlusion_m = self.ao;
        view.details = SurfaceDetails {
            normal_maps: self.normal_maps == Shown::On,
            specular: self.specular == Shown::On,
        };
        if view.fog.is_some() && bake.light.medium().is_none() {
            notes.push(format!(
                "bakes of kind {} have no probes in free space: fog shows light of lamps alone, none of skies and surfaces",
                bake.scene.manifest.kind
            ));
        }
        view.lod = self.lod;
        view.adapter_bytes_max = self.adapter_memory;
        notes.extend(self.lod.iter().flat_map(|lod| lod.notes(bake.scene.diagonal_m())));
        Ok((view, notes))
    }

    /// Colours of the bake's materials; objects with bakes of their own have theirs then.
    fn share(&self, manifest: &Manifest, objects: &mut [Beside]) -> Result<Vec<Recolour>> {
        Ok(share_colours(manifest, objects, &self.material)?)
    }

    /// A window's bake, and how it is looked at first: a server's comes piece by piece where it has an overview.
    #[cfg(feature = "view")]
    pub fn opened(
        &self,
        source: &Source,
        kinds: &ClientKinds,
        lighting: &LightArguments,
        objects: Vec<Beside>,
        max_memory: Option<u64>,
    ) -> Result<(Subject, View, Vec<String>)> {
        let budget = Budget { memory: max_memory.unwrap_or(u64::MAX), ..Budget::NONE };
        let part = match kinds.follow(source)? {
            Some(following) => {
                let mut following = following.patient();
                say!(
                    "the bake goes on: the window opens once its receivers are placed, and shows light as it is baked"
                );
                following.wait_for_outline()?;
                Some(StreamedBake::follow(following, kinds, budget)?)
            }
            None => {
                let (_, manifest) = source.manifest()?;
                check_colours(&manifest, &objects, &self.material)?;
                let streams =
                    matches!(source, Source::Server { .. }) && !manifest.chunks(OVERVIEW).is_empty();
                let is_part = streams || max_memory.is_some();
                is_part.then(|| StreamedBake::begin(source, kinds, budget)).transpose()?
            }
        };
        if let Some(mut streamed) = part {
            check_colours(&streamed.bake.scene.manifest, &objects, &self.material)?;
            streamed.add_objects(objects)?;
            let (view, notes) = self.view(&streamed.bake, lighting, None)?;
            return Ok((Subject::Streamed(Box::new(streamed)), view, notes));
        }
        let mut bake = LoadedBake::load(source, kinds)?;
        objects.iter().cloned().try_for_each(|object| bake.put(object))?;
        let (view, notes) = self.view(&bake, lighting, None)?;
        let (source, kinds) = (source.clone(), kinds.clone());
        let less = move || {
            let mut streamed = StreamedBake::begin(&source, &kinds, Budget::NONE)?;
            streamed.add_objects(objects)?;
            Ok(streamed)
        };
        Ok((Subject::Whole(Box::new(bake), Box::new(less)), view, notes))
    }

    /// Colours of materials.
    #[cfg(feature = "view")]
    pub fn colours(&self) -> &[Recolour] {
        &self.material
    }
}

impl PictureArguments {
    /// Refuses a camera or light that cannot be read, before any work is done.
    pub fn check(&self) -> Result<()> {
        self.look.check()
    }

    /// Refuses a camera or lights beside those of a path.
    pub fn check_beside(&self, path: &ViewPath) -> Result<()> {
        let both = |is_twice: bool, option: &str| {
            let what = format!("{option} and the keys of the path both say it");
            if is_twice { Err(Failure::bad_input(what).try_this("one of them alone")) } else { Ok(()) }
        };
        both(self.look.camera.is_some() && path.first_camera().is_some(), "--camera")?;
        both(!self.look.light.is_empty() && path.first_lights().is_some(), "--light")
    }

    /// Draws the bake and writes it as PNG, with as much of the light as is asked for, along a path, with objects; says on standard error what was
    /// chosen and who drew.
    pub fn draw_reel(
        &self,
        mut reel: Reel,
        kinds: &ClientKinds,
        lighting: &LightArguments,
        source: &Source,
        png: &Path,
    ) -> Result<Drawn> {
        let (mut objects, stances) = reel.take_objects();
        let path = reel.path.as_ref();
        let within = reel.budget.unwrap_or(Budget::NONE);
        let part = match kinds.follow(source)? {
            Some(following) => Some(StreamedBake::follow(following, kinds, within)?),
            None => reel.budget.map(|budget| StreamedBake::begin(source, kinds, budget)).transpose()?,
        };
        let Some(streamed) = part else {
            let own = self.look.share(&source.manifest()?.1, &mut objects)?;
            let mut bake = LoadedBake::load(source, kinds)?;
            bake.recolour(&own)?;
            let view = self.view_of_whole(&mut bake, &reel, (&objects, stances), lighting)?;
            let full = match self.write_all(&bake, &view, path, png) {
                Err(full @ ClientError::AdapterFull { .. }) => full,
                drawn => return Ok(drawn?),
            };
            // Kinds whose light does not come in pieces have no less of it.
            let Ok(streamed) = StreamedBake::begin(source, kinds, Budget::NONE) else {
                return Err(full.into());
            };
            let mut streamed = furnished(streamed, &own, objects)?;
            let memory = streamed.less_memory(u64::MAX).unwrap_or(0);
            let budget = Budget { memory, ..Budget::NONE };
            return self.write_part(&mut streamed, (budget, Some(full)), &view, path, png);
        };
        reel.check_part()?;
        let own = self.look.share(&streamed.bake.scene.manifest, &mut objects)?;
        let mut streamed = furnished(streamed, &own, objects)?;
        let view = View { objects: stances, ..self.view(&streamed.bake, lighting, path)? };
        self.write_part(&mut streamed, (within, None), &view, path, png)
    }

    /// As [`Self::draw_reel`], of an edit of a scene.
    pub fn draw_edit(
        &self,
        mut reel: Reel,
        mut edited: Edited,
        lighting: &LightArguments,
        png: &Path,
    ) -> Result<Drawn> {
        let (mut objects, stances) = reel.take_objects();
        let path = reel.path.as_ref();
        let own = self.look.share(&edited.bake.scene.manifest, &mut objects)?;
        edited.bake.recolour(&own)?;
        let view = self.view_of_whole(&mut edited.bake, &reel, (&objects, stances), lighting)?;
        let first = path.map_or_else(|| view.clone(), |path| path.view(1, &view));
        let share = provisional_share(&edited, &first)?;
        let drawn = self.write_all(&edited.bake, &view, path, png)?;
        say!("{:.1} % of the picture's light is that of walks until the edit is baked", 100.0 * share);
        Ok(Drawn { provisional: Some(share), ..drawn })
    }

    /// The view of a bake that has all of its light, with objects and what is to be shown of the bake put into it.
    fn view_of_whole(
        &self,
        bake: &mut LoadedBake,
        reel: &Reel,
        (objects, mut stances): (&[Beside], Vec<Stance>),
        lighting: &LightArguments,
    ) -> Result<View> {
        objects.iter().cloned().try_for_each(|object| bake.put(object))?;
        reel.show_in(bake, &mut stances)?;
        let mut view = View { objects: stances, ..self.view(bake, lighting, reel.path.as_ref())? };
        view.walks = Walks { occlusion_m: view.walks.occlusion_m, ..reel.walks() };
        Ok(view)
    }

    /// Draws with as much of the light as the budget allows, and the adapter has room for; `full` is its error where it had none for more.
    fn write_part(
        &self,
        streamed: &mut StreamedBake,
        (mut budget, mut full): (Budget, Option<ClientError>),
        view: &View,
        path: Option<&ViewPath>,
        png: &Path,
    ) -> Result<Drawn> {
        // Along a path, what its first picture needs.
        let first = path.map_or_else(|| view.clone(), |path| path.view(1, view));
        let drawn = loop {
            streamed.refine(&first, budget)?;
            let error = match self.write_all(&streamed.bake, view, path, png) {
                Err(error @ ClientError::AdapterFull { .. }) => error,
                drawn => break drawn?,
            };
            let Some(memory) = streamed.less_memory(budget.memory) else { return Err(error.into()) };
            (budget.memory, full) = (memory, Some(error));
        };
        let come = streamed.streamed();
        let Streamed { bytes, bytes_all, memory, baked, .. } = come;
        say!("{}", worded_part(&come));
        if let Some(full) = &full {
            say!("warning: less light was drawn than was asked for: {full}");
        }
        Ok(Drawn {
            light_bytes: Some(bytes),
            light_bytes_all: Some(bytes_all),
            light_memory: Some(memory),
            less_light: full.map(|full| full.to_string()),
            under_way: baked,
            ..drawn
        })
    }

    /// The view of a bake; says on standard error what was chosen.
    fn view(&self, bake: &LoadedBake, lighting: &LightArguments, path: Option<&ViewPath>) -> Result<View> {
        let (view, notes) = self.look.view(bake, lighting, path)?;
        for note in notes {
            say!("note: {note}");
        }
        Ok(view)
    }

    /// Draws the view, or all along a path, and writes them as PNG; says on standard error who drew.
    fn write_all(
        &self,
        bake: &LoadedBake,
        view: &View,
        path: Option<&ViewPath>,
        png: &Path,
    ) -> std::result::Result<Drawn, ClientError> {
        let start = Instant::now();
        let mut drawn = Drawn { converged: true, ..Drawn::default() };
        let mut take = |picture: Picture, file: PathBuf| -> std::result::Result<(), ClientError> {
            if !picture.converged {
                say!(
                    "warning: after {} bounces the light of {} had not converged; more of them would change it",
                    picture.bounces,
                    file.display()
                );
            }
            picture.write_png(&file)?;
            drawn.pictures.push(file.display().to_string());
            drawn.bounces = drawn.bounces.max(picture.bounces);
            drawn.converged &= picture.converged;
            drawn.passes = picture.pass_times.map(|times| times.iter().map(PassRow::of).collect());
            (drawn.drawn_by, drawn.exposure) = (picture.drawn_by, picture.exposure);
            drawn.lod = picture.lod.map(Vec::from);
            Ok(())
        };
        match (&self.debug, path) {
            (Some(name), _) => take(debug_picture(bake, view, name, self.page)?, png.to_owned())?,
            (None, None) => take(render(bake, view, self.backend.into())?, png.to_owned())?,
            (None, Some(path)) => {
                let file = |index: usize| numbered(png, index + 1);
                render_path(bake, path, view, self.backend.into(), |index, picture| {
                    take(picture, file(index))
                })?;
            }
        }
        drawn.seconds = start.elapsed().as_secs_f64();
        if let [first, .., last] = &drawn.pictures[..] {
            let (count, seconds) = (drawn.pictures.len(), drawn.seconds);
            say!("{count} pictures in {seconds:.1} s: {first} to {last}");
        }
        if let Some(levels) = &drawn.lod {
            say!("level of detail: {}", worded(levels));
        }
        say!("drawn by {}", drawn.drawn_by);
        Ok(drawn)
    }
}

/// Work of levels of detail in words.
fn worded(levels: &[LevelCount]) -> String {
    let sum = |of: fn(&LevelCount) -> u64| levels.iter().map(of).sum::<u64>();
    let percent = |part: u64, whole: u64| 100.0 * part as f64 / whole.max(1) as f64;
    let clusters: Vec<String> = levels.iter().map(|level| level.clusters.to_string()).collect();
    let (receivers, computed) = (sum(|level| level.receivers), sum(|level| level.receivers_computed));
    let (numbers, read) = (sum(|level| level.numbers), sum(|level| level.numbers_read));
    format!(
        "{computed} of {receivers} receivers computed ({:.0} %), {:.0} % of the factors' numbers read; clusters by level {}",
        percent(computed, receivers),
        percent(read, numbers),
        clusters.join(", ")
    )
}

impl From<ToneName> for Tone {
    fn from(name: ToneName) -> Self {
        match name {
            ToneName::Reinhard => Self::Reinhard,
            ToneName::Filmic => Self::Filmic,
            ToneName::Exposure => Self::Linear,
        }
    }
}

impl From<BackendName> for Backend {
    fn from(name: BackendName) -> Self {
        match name {
            BackendName::Auto => Self::Auto,
            BackendName::Gpu => Self::Gpu,
            BackendName::Cpu => Self::Cpu,
        }
    }
}

/// The bake with colours of its materials, and with objects.
fn furnished(mut streamed: StreamedBake, colours: &[Recolour], objects: Vec<Beside>) -> Result<StreamedBake> {
    streamed.recolour(colours)?;
    streamed.add_objects(objects)?;
    Ok(streamed)
}
