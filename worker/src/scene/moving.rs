//! A file whose things move: its meshes at any time of one of its animations.

use super::animation::{lengths_s, posed};
use super::context::{Budgets, Context};
use super::error::Result;
use super::materials::MaterialTable;
use super::model::{MeshInstance, Scene, Warning};
use super::warnings::Warnings;
use super::{Bundle, Limits, Opening, nodes, opened};

/// A glTF that stands beside a baked scene and moves.
#[derive(Debug)]
pub struct MovingFile {
    bundle: Bundle,
    limits: Limits,
    /// Materials, read once; images are the caller's.
    materials: MaterialTable,
    lengths_s: Vec<f32>,
}

impl MovingFile {
    /// Reads a file; its meshes at rest, with materials and images, and what was not honoured.
    pub fn open(bundle: Bundle, limits: Limits) -> Result<(Self, Scene, Vec<Warning>)> {
        let (read, materials, lengths_s, warnings) = opened(&bundle, &limits, Opening::Moving, |context| {
            let mut materials = MaterialTable::read(context)?;
            let mut scene = Scene::default();
            nodes::flatten(context, &mut materials, &mut scene)?;
            let lengths_s = lengths_s(context);
            Ok((scene, materials, lengths_s, std::mem::take(&mut context.warnings).finish()))
        })?;
        let (all, images, details) = materials.clone().finish();
        let images = [images, details].concat();
        let kept = materials.without_images();
        let scene = Scene { materials: all, images, ..read };
        Ok((Self { bundle, limits, materials: kept, lengths_s }, scene, warnings))
    }

    /// Length of each of its animations in seconds.
    pub fn lengths_s(&self) -> &[f32] {
        &self.lengths_s
    }

    /// Its meshes at a time of an animation, `clip` being below the number of them; at rest without one. Meshes, vertices and
    /// triangles are as many at all times.
    pub fn at(&self, clip: Option<usize>, time_s: f32) -> Result<Vec<MeshInstance>> {
        opened(&self.bundle, &self.limits, Opening::Moving, |context| {
            let root = match clip.filter(|clip| *clip < self.lengths_s.len()) {
                Some(clip) => posed(context, clip, time_s)?,
                None => context.root.clone(),
            };
            let mut then = Context {
                root: &root,
                bundle: context.bundle,
                buffers: context.buffers,
                limits: context.limits,
                budgets: Budgets::new(context.limits, context.bundle.upload_bytes()),
                warnings: Warnings::default(),
                opening: context.opening,
            };
            let mut scene = Scene::default();
            nodes::flatten(&mut then, &mut self.materials.clone(), &mut scene)?;
            Ok(scene.instances)
        })
    }
}
