//! Where the blocks of receivers lie in the pages of the lightmap atlas.

use serde::{Deserialize, Serialize};

use crate::content::BlockKey;

/// Layout of the lightmap atlas.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lightmap {
    /// Texel size in metres; in a scene with a core, of that.
    pub texel_m: f32,
    /// Atlas pages: width and height in texels.
    pub pages: Vec<[u32; 2]>,
    /// Blocks with their places, ascending by key.
    pub blocks: Vec<Block>,
}

/// A block: the receivers of one side of one mesh instance, as a rectangle of texels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// Identity; 16 hex digits in JSON, as numbers this large do not survive JavaScript.
    #[serde(with = "hex_key")]
    pub key: BlockKey,
    /// Instance path and side, for people.
    pub name: String,
    /// Width and height in texels.
    pub size: [u32; 2],
    /// Atlas page.
    pub page: u32,
    /// Corner in the page, in texels.
    pub origin: [u32; 2],
}

/// Keys as 16 hex digits.
pub(crate) mod hex_key {
    use serde::{Deserialize, Deserializer, Serializer, de};

    pub fn serialize<S: Serializer>(key: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{key:016x}"))
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        let text = String::deserialize(deserializer)?;
        if text.len() != 16 || !text.bytes().all(|b| matches!(b, b'0'..=b'9' | b'a'..=b'f')) {
            return Err(de::Error::custom(format_args!(
                "block key '{text:.20}' is not 16 lower-case hex digits"
            )));
        }
        u64::from_str_radix(&text, 16).map_err(de::Error::custom)
    }
}
