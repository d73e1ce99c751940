//! Textures: an image file as it was in the scene, with its media type. Stored as it is: PNG and JPEG are compressed.

use super::bytes::Reader;
use super::container::{Container, ContainerWriter, SectionId, check_expansion};
use super::error::{ChunkError, in_range};
use super::limits::{MEDIA_TYPE_BYTES_MAX, TEXTURE_BYTES_MAX};
use super::table::TEXTURE;

/// Section tags of texture chunks.
pub(super) mod tags {
    /// The file. Part: 0, 0, 0.
    pub const FILE: u8 = 1;
}

/// An image file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Texture {
    /// Media type, such as `image/png`.
    pub media_type: String,
    /// The file.
    pub bytes: Vec<u8>,
}

/// Encodes an image file. Errs if it is too long or next to nothing once compressed, as no image is, or the media type is
/// not 1 to 64 printable ASCII characters.
pub fn encode_texture(media_type: &str, bytes: &[u8]) -> Result<Vec<u8>, ChunkError> {
    check_media_type("encoder", media_type.as_bytes())?;
    in_range("encoder", "file length", bytes.len() as u64, 0, TEXTURE_BYTES_MAX as u64)?;
    let mut writer = ContainerWriter::new(TEXTURE);
    writer.push(SectionId::new(tags::FILE, [0; 3]), bytes)?;
    let (chunk, _) = writer.finish(media_type.as_bytes())?;
    check_expansion("encoder", bytes.len() as u64, chunk.len() as u64)?;
    Ok(chunk)
}

/// Decodes a texture chunk. The image itself is not looked at.
pub fn decode_texture(bytes: &[u8]) -> Result<Texture, ChunkError> {
    let container = Container::whole(TEXTURE, bytes)?;
    let media_type = check_media_type("texture head", container.head)?;
    container.check_sections(&[SectionId::new(tags::FILE, [0; 3])])?;
    let bytes = container.section(0, "file", TEXTURE_BYTES_MAX as u64)?;
    Ok(Texture { media_type, bytes })
}

fn check_media_type(section: &'static str, text: &[u8]) -> Result<String, ChunkError> {
    let mut reader = Reader::new(section, text);
    in_range(section, "length of media type", text.len() as u64, 1, MEDIA_TYPE_BYTES_MAX as u64)?;
    let mut media_type = String::with_capacity(text.len());
    for _ in 0..text.len() {
        let byte = reader.u8("media type")?;
        in_range(section, "character of media type", byte.into(), 0x21, 0x7e)?;
        media_type.push(char::from(byte));
    }
    Ok(media_type)
}
