//! Light that objects with bakes of their own give and take: their parts' radiance in place of what these hide (METHOD.md §2.17).

mod feed;
mod moved;
pub mod reference;
mod silhouettes;
mod table;

pub use feed::{FeedNumbers, FeedPass};
pub use moved::{MovedBuffers, MovedNumbers, MovedPass};
pub use silhouettes::{EmitterPoint, Silhouettes, silhouette_plan};
pub(in crate::passes) use table::rows_of;
pub use table::{MOVERS_MAX, MoverLevelRow, MoverNumbers, MoverRow, MoverTable};

/// The shader of receivers, with the lights' part in front.
pub const TEXELS_SHADER: &str = concat!(
    include_str!("../shared/light.wgsl"),
    include_str!("../shared/rect.wgsl"),
    include_str!("../shared/shadow_map.wgsl"),
    include_str!("volume.wgsl"),
    include_str!("sights.wgsl"),
    include_str!("silhouettes.wgsl"),
    include_str!("texels.wgsl")
);
/// The shader's part for pixels; and what stands for it in scenes without such objects.
pub const PIXELS: &str = concat!(
    include_str!("volume.wgsl"),
    include_str!("sights.wgsl"),
    include_str!("silhouettes.wgsl"),
    include_str!("pixels.wgsl")
);
/// The shader of light that is changed before it bounces.
pub const FEED_SHADER: &str = include_str!("feed.wgsl");
/// Largest difference of light at receivers from the processor's with objects in it, as a root mean square of its mean: sums over some parts of
/// numbers of either sign, bounces that end elsewhere, and shadow maps' rounding.
pub const TOLERANCE: f64 = 2e-3;
/// Share of pixels that may differ by more than that of shading: a texel of what an object sees falls to either side of an edge by one rounding.
pub const OUTLIERS: f64 = 2e-3;
