//! A bake as evaluation sees it, whatever its kind.

use glam::{DVec3, Vec2};
use lightkiln_proto::content::{BlockKey, Texel};
use lightkiln_proto::ids::Digest;

use super::{EvaluationError, MappedIncoming, Sample, TestLight};
use crate::geometry::{Geometry, Site};
use crate::rays::Hit;
use crate::reference::{Lighting, Reference};
use crate::task::{Cancelled, Progress};

/// Gives the bytes of a bake's chunk.
pub type ChunkBytes<'a> = &'a (dyn Fn(Digest) -> Result<Vec<u8>, EvaluationError> + Sync);

/// A place whose light a bake is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Point and normals.
    pub site: Site,
    /// Number by which the kind knows the place again, a receiver's say: answers of one number are one place. `None` where
    /// the kind answers at any point.
    pub number: Option<u32>,
}

/// A bake's answer to a hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer {
    /// It shows the light of that place.
    Place(Place),
    /// None: the surface lies in a cavity that nothing in the open sees.
    Cavity,
    /// None: the surface is too small, or too deep in geometry.
    TooSmall,
}

/// A decoded bake in its scene.
pub trait Evaluated: Send + Sync {
    /// The scene.
    fn geometry(&self) -> &Geometry;

    /// The place whose light is shown at a hit.
    fn answer_at(&self, hit: &Hit) -> Answer;

    /// Points whose mean light a place stands for, one at least: of a texel those on its receiver's side of every wall.
    fn points_of(&self, place: &Place) -> Vec<Site> {
        vec![place.site]
    }

    /// Places to measure at, about `count`: spread over the lit surfaces by area, unless the kind's light is elsewhere.
    fn sample(&self, count: u32) -> Sample {
        Sample::of_surfaces(self.geometry(), |hit| self.answer_at(hit), count)
    }

    /// The lightmap, if the kind has one.
    fn lightmap(&self) -> Option<&dyn EvaluatedLightmap> {
        None
    }

    /// The bake as it lights free space, where it does: its places are points there, with a direction each.
    fn in_space(self: Box<Self>) -> Option<Box<dyn Evaluated>> {
        None
    }

    /// The bake with E_ind by walks through its voxels, if it has some.
    fn by_walks(self: Box<Self>) -> Option<Box<dyn Evaluated>> {
        None
    }

    /// The light that alone the bake can be measured under: that which it was baked with, where it cannot be relit.
    fn own_light(&self) -> Option<TestLight> {
        None
    }

    /// Chunk that holds a place's light, as an index among those of its role; `None` where the bake left the place out.
    fn chunk_of(&self, place: &Place) -> Option<usize>;

    /// Prepares to tell classes of error apart at some places, once for all lights. More `effort` → surer, more time.
    fn trace(&mut self, sample: &[Place], effort: usize, progress: &Progress) -> Result<(), Cancelled> {
        let _ = (sample, effort, progress);
        Ok(())
    }

    /// Facts about the bake at some places, in words.
    fn notes(&self, sample: &[Place]) -> Vec<String> {
        let _ = sample;
        Vec::new()
    }

    /// Units of work, and chunks in them, that [`Evaluated::trace`] made anew.
    fn traced(&self) -> [usize; 2] {
        [0; 2]
    }

    /// The bake under some lights, all bounces in.
    fn relit<'a>(
        &'a self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Box<dyn Relit + 'a>, Cancelled>;

    /// As [`Evaluated::relit`], with E_dir as a client's shadow maps have it; `None` where the kind bounces no such light.
    fn relit_by_maps<'a>(
        &'a self,
        lighting: &Lighting,
        direct: &MappedIncoming,
    ) -> Option<Box<dyn Relit + 'a>> {
        let _ = (lighting, direct);
        None
    }
}

/// The lightmap of a bake: its receivers and what lies beside them.
pub trait EvaluatedLightmap: Sync {
    /// Side of a texel in metres.
    fn texel_m(&self) -> f32;

    /// Receivers that have light.
    fn receivers(&self) -> u32;

    /// The place of a receiver.
    fn receiver(&self, index: u32) -> Place;

    /// The receiver at an offset of one texel at most along each axis, if no wall parts it from another.
    fn linked(&self, index: u32, offset: [i32; 2]) -> Option<u32>;

    /// Path, part and side of a block in words.
    fn block_name(&self, block: BlockKey) -> &str;

    /// Texel that holds a place's light.
    fn texel_of(&self, place: &Place) -> Option<(BlockKey, Texel)>;

    /// The place whose light a texel holds.
    fn place_of(&self, block: BlockKey, texel: Texel) -> Option<Place>;

    /// Block and texel that pictures read at a hit.
    fn texel_at(&self, hit: &Hit) -> Option<(BlockKey, Vec2)>;
}

/// A bake under some lights.
pub trait Relit: Sync {
    /// E_ind at a place, W·m⁻²; `None` where the bake left the place out as unreachable.
    fn irradiance(&self, place: &Place) -> Option<DVec3>;

    /// E_ind that a picture shows at a hit, W·m⁻², of kinds with a lightmap; `None` where it shows none.
    fn shown_at(&self, hit: &Hit) -> Option<DVec3> {
        let _ = hit;
        None
    }

    /// Bounces until it changed no more, and whether it did before the last one allowed.
    fn bounces(&self) -> (usize, bool);

    /// The kind's classes of error, at the places of [`Evaluated::trace`].
    fn classes(&self, sample: &[Place]) -> Vec<ErrorClass> {
        let _ = sample;
        Vec::new()
    }
}

/// A cause of error, told apart from the others.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorClass {
    /// Short name.
    pub name: &'static str,
    /// Its cause, in a few words.
    pub about: &'static str,
    /// Its size.
    pub measure: Measure,
}

/// Size of a class of error.
#[derive(Clone, Debug, PartialEq)]
pub enum Measure {
    /// Light at each place of the sample with no other error than this one, or read another way, to compare, W·m⁻²: its error is that
    /// against the reference.
    AtSample(Vec<DVec3>),
    /// Root mean square error of luminance, W·m⁻².
    Rms(f64),
}
