//! A bake among others: objects with bakes of their own stand beside it, or it is that of one.

use std::sync::Arc;

use glam::{Affine3A, Mat3, Vec4};
use lightkiln_proto::manifest::Manifest;

use super::LoadedBake;
use crate::error::{ClientError, Result};
use crate::scene::{Object, Recolour, Stance, check_among, named_in, turn_of, world_from_object};

/// Where a bake's own space stands, and the light that others give it and take from it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Among<'a> {
    /// Its own space in that of the lights, of uniform scale: they are one where it is not an object that moves.
    pub world_from_scene: Affine3A,
    /// Irradiance by slot of what is around it, W·m⁻², in place of the sky: what [`Light::sky_rows`](super::Light::sky_rows) make of it.
    pub around: Option<&'a [Vec4]>,
    /// Irradiance by slot that objects beside it give and take, W·m⁻².
    pub moved: Option<&'a [Vec4]>,
}

impl Among<'_> {
    /// The turn from its own space to that of the lights.
    pub fn turn(&self) -> Mat3 {
        turn_of(&self.world_from_scene)
    }
}

/// An object beside a bake with a bake of its own.
#[derive(Clone, Debug)]
pub struct Mover {
    /// Its number among the objects of the scene.
    pub object: usize,
    /// First of its meshes among the scene's, and the end: those of its own scene, in order.
    pub draws: [usize; 2],
    /// Its meshes and light, in its own space.
    pub bake: Arc<LoadedBake>,
}

/// An object to be put beside a bake.
#[derive(Clone, Debug)]
pub enum Beside {
    /// Meshes alone: lit by lights and by what a bake knows of free space.
    Meshes(Object),
    /// With a bake of its own.
    Baked {
        /// Name for messages.
        name: String,
        /// The bake.
        bake: Arc<LoadedBake>,
    },
}

impl Mover {
    /// Its place where stances of objects have it.
    pub fn world_from_object(&self, stances: &[Stance]) -> Affine3A {
        world_from_object(&stances.get(self.object).copied().unwrap_or_default())
    }
}

impl Beside {
    /// The meshes of a bake alone.
    pub fn meshes_of(bake: &LoadedBake, name: &str) -> Self {
        Self::Meshes(bake.scene.as_object(name))
    }
}

/// Refuses colours that neither materials of a bake nor of objects with bakes of their own can have.
pub fn check_colours(manifest: &Manifest, objects: &[Beside], colours: &[Recolour]) -> Result<()> {
    let of_objects = objects.iter().filter_map(|object| match object {
        Beside::Baked { bake, .. } => Some(&bake.scene.manifest.materials),
        Beside::Meshes(_) => None,
    });
    check_among(manifest.materials.iter().chain(of_objects.flatten()), colours)
}

/// Gives objects with bakes of their own those colours whose names their materials have, and tells which the bake's own have. Errs for a name that
/// neither has. Before they are put beside a bake.
pub fn share_colours(
    manifest: &Manifest,
    objects: &mut [Beside],
    colours: &[Recolour],
) -> Result<Vec<Recolour>> {
    check_colours(manifest, objects, colours)?;
    for object in objects {
        if let Beside::Baked { bake, .. } = object {
            recolour(bake, colours)?;
        }
    }
    let is_own =
        |colour: &&Recolour| manifest.materials.iter().any(|material| material.name == colour.material);
    Ok(colours.iter().filter(is_own).cloned().collect())
}

/// Gives an object's bake those colours whose names its materials have.
pub(super) fn recolour(bake: &mut Arc<LoadedBake>, colours: &[Recolour]) -> Result<()> {
    let own = named_in(&bake.scene, colours);
    let Some(first) = own.first() else { return Ok(()) };
    let what = format!("material '{}'", first.material);
    let problem = "is that of an object which stands elsewhere as well, with the colour that it has; load the object anew";
    let bake = Arc::get_mut(bake).ok_or(ClientError::Argument { what, problem: problem.to_owned() })?;
    bake.recolour(&own)
}

impl LoadedBake {
    /// Puts an object beside the bake, at rest at the origin.
    pub fn put(&mut self, beside: Beside) -> Result<()> {
        match beside {
            Beside::Meshes(object) => self.add_object(object),
            Beside::Baked { name, bake } => self.add_mover(&name, bake),
        }
    }

    /// Puts an object with a bake of its own beside the bake, at rest at the origin: it is lit by the bake, casts indirect light and shadow on it,
    /// and moves as other objects do. Errs where its bake has no volume, or this one no voxels that tell which light comes to it.
    pub fn add_mover(&mut self, name: &str, bake: Arc<Self>) -> Result<()> {
        let refused = |problem: &str| {
            Err(ClientError::Argument { what: format!("object '{name}'"), problem: problem.to_owned() })
        };
        if bake.light.volume().is_none() {
            return refused("is a bake of a place, not of an object; bake it with --kind transfer");
        }
        if !bake.movers.is_empty() {
            return refused("has objects of its own beside it");
        }
        if self.light.voxels().is_none() {
            return refused(
                "asks the bake that it stands in for voxels, which tell its light: bake that again with voxels=on, or with a kind that has them",
            );
        }
        let first = self.scene.draws.draws.len();
        self.add_object(bake.scene.as_object(name))?;
        Arc::make_mut(&mut self.scene).colour_last_object();
        let (object, draws) = (self.scene.objects() - 1, [first, self.scene.draws.draws.len()]);
        self.movers.push(Mover { object, draws, bake });
        Ok(())
    }
}
