//! The lists of a glTF's JSON, counted before they are read: an object of three bytes takes hundreds in memory.

use std::fmt;

use gltf::json::{
    Accessor, Animation, Buffer, Camera, Image, Material, Mesh, Node, Scene, Skin, Texture, buffer, texture,
};
use serde::Deserialize;
use serde::de::{Deserializer, IgnoredAny, SeqAccess, Visitor};

use super::error::Result;
use super::limits::{self, Limits, within};

/// Lengths of all lists.
#[derive(Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
struct Census {
    accessors: Count,
    animations: Count,
    buffers: Count,
    buffer_views: Count,
    cameras: Count,
    images: Count,
    materials: Count,
    meshes: Count,
    nodes: Count,
    samplers: Count,
    scenes: Count,
    skins: Count,
    textures: Count,
}

/// Length of one list; 0 of anything else, which the reader refuses.
#[derive(Clone, Copy, Default)]
struct Count(u64);

impl<'de> Deserialize<'de> for Count {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Counter;
        impl<'de> Visitor<'de> for Counter {
            type Value = Count;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Count, A::Error> {
                let mut count = 0;
                while list.next_element::<IgnoredAny>()?.is_some() {
                    count += 1;
                }
                Ok(Count(count))
            }
        }
        deserializer.deserialize_seq(Counter)
    }
}

/// Holds the lists of the JSON against the limit of what they take in memory; JSON that is no glTF passes, as the reader
/// says what is wrong with it.
pub(super) fn check(json: &[u8], limits: &Limits) -> Result<()> {
    let Ok(census) = serde_json::from_slice::<Census>(json) else { return Ok(()) };
    within(limits::JSON_TREE, census.bytes(), limits.json_tree_bytes)
}

impl Census {
    fn bytes(&self) -> u64 {
        let lists = [
            (self.accessors, size_of::<Accessor>()),
            (self.animations, size_of::<Animation>()),
            (self.buffers, size_of::<Buffer>()),
            (self.buffer_views, size_of::<buffer::View>()),
            (self.cameras, size_of::<Camera>()),
            (self.images, size_of::<Image>()),
            (self.materials, size_of::<Material>()),
            (self.meshes, size_of::<Mesh>()),
            (self.nodes, size_of::<Node>()),
            (self.samplers, size_of::<texture::Sampler>()),
            (self.scenes, size_of::<Scene>()),
            (self.skins, size_of::<Skin>()),
            (self.textures, size_of::<Texture>()),
        ];
        lists.iter().map(|(count, size)| count.0.saturating_mul(*size as u64)).sum()
    }
}
