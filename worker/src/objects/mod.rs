//! Objects that move beside a baked scene: the meshes of a glTF, as a client draws them, at a time of its animations.

use lightkiln_proto::content::Draw;
use lightkiln_proto::manifest::Material;

use crate::assemble::materials::materials;
use crate::draw::draws_as_they_are;
use crate::scene::model::{Scene, SceneImage, Warning};
use crate::scene::{Bundle, ImportError, Limits, MovingFile};

/// A glTF whose meshes are read at any time.
#[derive(Debug)]
pub struct ObjectFile {
    file: MovingFile,
    /// Materials, without meshes and images.
    looks: Scene,
    images: Vec<SceneImage>,
}

impl ObjectFile {
    /// Reads a file, and what of it was not honoured.
    pub fn open(bundle: Bundle) -> Result<(Self, Vec<Warning>), ImportError> {
        let (file, rest, mut warnings) = MovingFile::open(bundle, Limits::default())?;
        let Scene { materials, images, instances, .. } = rest;
        let is_lit = |index: &u32| materials[*index as usize].emissive != [0.0; 3];
        if instances.iter().map(|instance| instance.material_index).any(|index| is_lit(&index)) {
            let message = "it has materials that emit: they are drawn bright, and light nothing".to_owned();
            warnings.push(Warning { code: "object-emits".to_owned(), message });
        }
        Ok((Self { file, looks: Scene { materials, ..Scene::default() }, images }, warnings))
    }

    /// Materials that its meshes name; none is an emitter.
    pub fn materials(&self) -> Vec<Material> {
        let all = materials(&self.looks).0.into_iter();
        all.map(|material| Material { emitter: None, ..material }).collect()
    }

    /// Images that the materials name.
    pub fn images(&self) -> &[SceneImage] {
        &self.images
    }

    /// Length of each animation in seconds.
    pub fn lengths_s(&self) -> &[f32] {
        self.file.lengths_s()
    }

    /// Meshes at a time of an animation, counted from 0; at rest without one. They are as many, and as large, at all times.
    pub fn draws(&self, clip: Option<usize>, time_s: f32) -> Result<Vec<Draw>, ImportError> {
        let instances = self.file.at(clip, time_s)?;
        let of_instance = |instance| draws_as_they_are(&self.looks, instance);
        Ok(instances.iter().flat_map(of_instance).collect())
    }
}
