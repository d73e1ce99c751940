//! A bake as evaluation sees it, whatever its kind.

use glam::{DVec3, Vec2};
use lightkiln_proto::content::{BlockKey, Texel};
use lightkiln_proto::ids::Digest;

use super::EvaluationError;
use crate::geometry::{Geometry, Site};
use crate::rays::Hit;
use crate::reference::{Lighting, Reference};
use crate::task::{Cancelled, Progress};

/// Gives the bytes of a bake's chunk.
pub type ChunkBytes<'a> = &'a (dyn Fn(Digest) -> Result<Vec<u8>, EvaluationError> + Sync);

/// A place whose light a bake knows, as the kind numbers them: a receiver, say.
pub type PlaceId = u32;

/// A bake's answer to a hit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// It shows the light of that place.
    Place(PlaceId),
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

    /// The point and normal that a place's light is of.
    fn site(&self, place: PlaceId) -> Site;

    /// Texel of a place in the lightmap, if the kind has one.
    fn texel(&self, place: PlaceId) -> Option<(BlockKey, Texel)>;

    /// The place of a texel of the lightmap, if the kind has one there.
    fn place_of(&self, _: BlockKey, _: Texel) -> Option<PlaceId> {
        None
    }

    /// Block and texel that pictures read at a hit, if the kind has a lightmap.
    fn lightmap_at(&self, hit: &Hit) -> Option<(BlockKey, Vec2)>;

    /// Chunk that holds a place's light, as an index among those of its role; `None` where the bake left the place out.
    fn chunk_of(&self, place: PlaceId) -> Option<usize>;

    /// Prepares to tell classes of error apart at some places, once for all lights. More `effort` → surer, more time.
    fn trace(&mut self, sample: &[PlaceId], effort: usize, progress: &Progress) -> Result<(), Cancelled>;

    /// Units of work, and chunks in them, that [`Evaluated::trace`] made anew.
    fn traced(&self) -> [usize; 2];

    /// The bake under some lights, all bounces in.
    fn relit<'a>(
        &'a self,
        reference: &Reference,
        lighting: &Lighting,
        progress: &Progress,
    ) -> Result<Box<dyn Relit + 'a>, Cancelled>;
}

/// A bake under some lights.
pub trait Relit: Sync {
    /// E_ind at a place, W·m⁻²; `None` where the bake left the place out as unreachable.
    fn irradiance(&self, place: PlaceId) -> Option<DVec3>;

    /// Bounces until it changed no more, and whether it did before the last one allowed.
    fn bounces(&self) -> (usize, bool);

    /// The kind's classes of error, at the places of [`Evaluated::trace`].
    fn classes(&self, sample: &[PlaceId]) -> Vec<ErrorClass>;
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
    /// Light at each place of the sample with no other error than this one, W·m⁻²: its error is that against the reference.
    AtSample(Vec<DVec3>),
    /// Root mean square error of luminance, W·m⁻².
    Rms(f64),
}
