//! Parts of a picture that walks through voxels make.

use std::sync::Arc;

use super::Frame;
use crate::bake::emitter_radiance;
use crate::error::{ClientError, Result};
use crate::passes::shade::ShadeView;
use crate::passes::walk::{WalkPass, WalkTable, Walks};

/// Elements and pipelines, made for the first picture that needs them.
#[derive(Debug)]
pub(super) struct Walking {
    table: Arc<WalkTable>,
    pass: WalkPass,
    /// Size, step and whether there is irradiance of the pictures that there is room for.
    room: Option<([u32; 2], u32, bool)>,
}

impl Walking {
    /// There is no room for a picture of another size.
    pub(super) fn forget_room(&mut self) {
        self.room = None;
        self.pass.drop_room();
    }
}

impl Frame<'_> {
    /// Sets which parts walks make. The first picture with some makes buffers for them, as does the first of another size, with other parts, or
    /// with another bake. Errs, and changes nothing, where the bake has no voxels for what is asked.
    pub fn set_walks(&mut self, walks: Walks) -> Result<()> {
        let wrong =
            |problem: &str| ClientError::Argument { what: "walks".to_owned(), problem: problem.to_owned() };
        if let Some(problem) = walks.problem() {
            return Err(wrong(problem));
        }
        if walks.asks_for_voxels() && self.bake.light.voxels().is_none() {
            return Err(wrong("need a bake with voxels; bake it with --set voxels=on"));
        }
        self.walks = walks;
        Ok(())
    }

    /// Lets go of elements of another bake; the next picture uploads its own.
    pub(super) fn drop_walks(&mut self) {
        self.walking = None;
        self.shade.bind_walked(&self.gpu, None);
    }

    /// Writes what elements emit.
    pub(super) fn write_glows(&self) {
        let of_movers = self.walks_of_movers();
        let walks = of_movers.or(self.walking.as_ref().map(|walking| &walking.table));
        let (Some(walks), Some((table, _))) = (walks, self.bake.light.voxels()) else { return };
        let emitters = emitter_radiance(&self.bake.scene.manifest, &self.emitter_scale);
        let radiance = |emitter: u16| emitters.get(usize::from(emitter)).copied().unwrap_or_default();
        walks.set_emitters(&self.gpu, table, radiance);
    }

    /// Parts of the next picture that walks make; none over colours that stand for light.
    pub(super) fn walks_now(&self) -> Option<Walks> {
        self.bake.light.voxels()?;
        let reflects = self.walks.reflections
            && self.details.specular
            && self.bake.scene.manifest.materials.iter().any(|material| material.specular.is_some());
        let walks = Walks { reflections: reflects, ..self.walks };
        (self.overlay.is_none() && (walks.parts() != 0 || walks.eye)).then_some(walks)
    }

    /// Walks from the pixels of a view, which is then to be shaded with what they find. Where there is no room for it, nothing walks any more; the
    /// error says so once where walks were asked for, and reflections that were not are those of shading alone.
    pub(super) fn walk(&mut self, view: ShadeView, jitter: [f32; 2]) -> Result<ShadeView> {
        let Some(walks) = self.walks_now() else { return Ok(view) };
        if let Err(error) = self.make_walks(&walks) {
            self.walks =
                Walks { reflections: false, occlusion_m: None, irradiance: false, eye: false, ..walks };
            self.drop_walks();
            self.gpu.let_go()?;
            if walks.asks_for_voxels() || !matches!(error, ClientError::AdapterFull { .. }) {
                return Err(error);
            }
            tracing::warn!(%error, "reflections show light of directions alone");
            return Ok(view);
        }
        let Some(walking) = &self.walking else { return Ok(view) };
        let view = view.with_walked(if walks.eye { 0 } else { walks.parts() }, walks.step);
        walking.pass.set(&self.gpu, &view, (self.room.size, &walks), jitter);
        if view.parts_walked() != 0 {
            self.shade.draw_starts((&self.gpu, &mut self.watch), &self.meshes, &self.shadow, &view);
            self.watch.submit(&self.gpu, |encoder| walking.pass.record(encoder, &walking.table));
        }
        Ok(view)
    }

    /// Draws what walks from the eye meet in place of the picture, where that is asked for.
    pub(super) fn draw_walks_of_eye(&mut self) {
        let (Some(walking), true) = (&self.walking, self.walks_now().is_some_and(|walks| walks.eye)) else {
            return;
        };
        let picture = self.shade.radiance();
        self.watch.submit(&self.gpu, |encoder| walking.pass.draw_seen(encoder, &walking.table, picture));
    }

    /// Elements that objects with bakes of their own are lit by.
    fn walks_of_movers(&self) -> Option<&Arc<WalkTable>> {
        Some(&self.movers.as_ref()?.around.as_ref()?.walks)
    }

    fn make_walks(&mut self, walks: &Walks) -> Result<()> {
        let (Some(elements), Some(lambda)) = (self.bake.light.voxels(), self.light.lambda()) else {
            return Ok(());
        };
        if self.walking.is_none() {
            let table = match self.walks_of_movers() {
                Some(walks) => walks.clone(),
                None => Arc::new(WalkTable::new(&self.gpu, elements, lambda)?),
            };
            let pass = WalkPass::new(&self.gpu, &table, self.shade.view_buffer());
            self.gpu.check()?;
            self.walking = Some(Walking { table, pass, room: None });
            self.write_glows();
        }
        let wanted = (self.room.size, walks.step, walks.irradiance);
        let Some(walking) = self.walking.as_mut().filter(|walking| walking.room != Some(wanted)) else {
            return Ok(());
        };
        self.shade.make_starts(&self.gpu)?;
        if let Some(starts) = self.shade.starts() {
            walking.pass.make_room(&self.gpu, self.shade.view_buffer(), starts, (self.room.size, walks))?;
        }
        self.gpu.check()?;
        self.shade.bind_walked(&self.gpu, walking.pass.walked());
        walking.room = Some(wanted);
        Ok(())
    }
}
