//! Kinds of vectors that a processor may have.

use fearless_simd::Level;

/// The vectors that rays are cast with. All give the same numbers.
#[derive(Clone, Copy, Debug)]
pub struct Vectors(pub(super) Level);

impl Default for Vectors {
    /// The widest that this processor has.
    fn default() -> Self {
        Self(Level::new())
    }
}

impl Vectors {
    /// All that this processor has, the widest last.
    pub fn all() -> Vec<Self> {
        let own = Level::new();
        #[cfg(target_arch = "x86_64")]
        let lesser = [
            own.as_sse2().map(Level::Sse2),
            own.as_sse4_2().map(Level::Sse4_2),
            own.as_avx2().map(Level::Avx2),
        ];
        #[cfg(not(target_arch = "x86_64"))]
        let lesser: [Option<Level>; 0] = [];
        let is_lesser = |level: &Level| std::mem::discriminant(level) != std::mem::discriminant(&own);
        lesser.into_iter().flatten().filter(is_lesser).chain([own]).map(Self).collect()
    }

    /// Its name.
    pub fn name(&self) -> String {
        let debug = format!("{:?}", self.0);
        debug.split('(').next().unwrap_or_default().to_owned()
    }
}
