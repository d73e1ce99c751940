//! What bakes have cost so far, as a measure of those to come: by receiver, since everything else follows from them.

/// Cost of a bake for each of its receivers, of a kind and its settings. Measured, so right within a factor of two or three.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Processor time in microseconds.
    pub cpu_us: f64,
    /// Bytes of the bundle, beside those of meshes and textures.
    pub bundle_bytes: f64,
    /// Bytes of memory while it bakes, beside those of meshes and textures.
    pub memory_bytes: f64,
    /// Most receivers of a cluster: each cluster is a task.
    pub cluster_receivers: f64,
    /// Scenes and machine that the rates were measured on, for people.
    pub measured: &'static str,
}
