//! Images: kept encoded, once it is sure that they decode within the limits.

use std::borrow::Cow;
use std::io::Cursor;

use image::error::{DecodingError, ImageFormatHint};
use image::{DynamicImage, ImageDecoder, ImageError, ImageFormat, ImageReader};

use super::buffers::read_uri;
use super::context::Context;
use super::document::image_place;
use super::error::{ImportError, Result};
use super::limits::{self, within};
use super::model::SceneImage;

/// Memory for decoding beside 8 bytes a pixel, in bytes.
const DECODER_SLACK_BYTES: u64 = 64 << 20;

/// Most decoded bytes per byte of an image file: deflate makes 1032 of one, and eight pixels of a byte.
const EXPANSION_MAX: u64 = 8 * 1032;
/// Decoded bytes that any image may have.
const EXPANSION_FREE_BYTES: u64 = 1 << 20;

/// Start of a Git LFS pointer, which stands where an image should when the real one was not fetched.
const LFS_POINTER: &[u8] = b"version https://git-lfs";

/// Reads image `index` of the file, or warns and gives `None` if its format is none that is read.
///
/// Errors on missing files, images beyond the limits and images that do not decode.
pub(super) fn read_image(context: &mut Context<'_>, index: usize) -> Result<Option<SceneImage>> {
    let root = context.root;
    let place = || image_place(root, index);
    let bytes = image_bytes(context, index)?;
    let Some(format) = supported_format(&bytes) else {
        if is_other_image(&bytes) {
            context.warnings.add("texture-format-unsupported", || {
                format!("{} is neither PNG nor JPEG; the material's factor alone is used", place())
            });
            return Ok(None);
        }
        let hint = if bytes.starts_with(LFS_POINTER) { " but a Git LFS pointer (git lfs pull)" } else { "" };
        let unknown = DecodingError::new(ImageFormatHint::Unknown, "unknown first bytes");
        return Err(ImportError::Image { place: place(), hint, source: ImageError::Decoding(unknown) });
    };
    let unreadable = |source| ImportError::Image { place: place(), hint: "", source };
    let (width, height) = header_size(&bytes, format).map_err(unreadable)?;
    let pixels = u64::from(width) * u64::from(height);
    within(limits::TEXTURE_PIXELS, pixels, context.limits.texture_pixels_each)?;
    context.budgets.texture_pixels.spend(pixels)?;
    decode_as(&bytes, format).map_err(unreadable)?;
    let stated = &root.images[index];
    let uri = stated.uri.as_deref().filter(|uri| !uri.starts_with("data:"));
    let name = stated.name.as_deref().or(uri).map_or_else(|| format!("image {index}"), str::to_owned);
    Ok(Some(SceneImage {
        name,
        media_type: format.to_mime_type().to_owned(),
        bytes: bytes.into_owned(),
        size_px: [width, height],
    }))
}

/// Decodes an image of an imported scene.
///
/// Errors if its bytes do not decode, which a scene from [`super::import`] rules out.
pub(super) fn decode(image: &SceneImage) -> Result<DynamicImage> {
    let unreadable = |source| ImportError::Image { place: image.name.clone(), hint: "", source };
    let format = ImageFormat::from_mime_type(&image.media_type).unwrap_or(ImageFormat::Png);
    decode_as(&image.bytes, format).map_err(unreadable)
}

/// The encoded bytes of image `index` of the file.
pub(super) fn image_bytes<'a>(context: &Context<'a>, index: usize) -> Result<Cow<'a, [u8]>> {
    let root = context.root;
    let place = || image_place(root, index);
    match (&root.images[index].uri, root.images[index].buffer_view) {
        (Some(uri), _) => read_uri(uri, place(), context.bundle),
        (None, Some(view)) => context.buffers.view(view, &place).map(Cow::Borrowed),
        (None, None) => Err(ImportError::Buffer {
            place: place(),
            problem: "it has neither a URI nor a buffer view".to_owned(),
        }),
    }
}

/// The format by the first bytes: stated media types are wrong too often.
fn supported_format(bytes: &[u8]) -> Option<ImageFormat> {
    if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        return Some(ImageFormat::Png);
    }
    bytes.starts_with(b"\xFF\xD8\xFF").then_some(ImageFormat::Jpeg)
}

/// Whether the bytes are an image of a kind that glTF extensions and old exporters use, but that is not read here.
fn is_other_image(bytes: &[u8]) -> bool {
    let is_riff_webp = bytes.starts_with(b"RIFF") && bytes.get(8..12) == Some(b"WEBP");
    let is_avif = bytes.get(4..12) == Some(b"ftypavif");
    let starts: [&[u8]; 5] = [b"\xABKTX ", b"DDS ", b"GIF8", b"BM", b"II*\0"];
    is_riff_webp || is_avif || starts.iter().any(|start| bytes.starts_with(start))
}

fn header_size(bytes: &[u8], format: ImageFormat) -> Result<(u32, u32), ImageError> {
    ImageReader::with_format(Cursor::new(bytes), format).into_dimensions()
}

fn decode_as(bytes: &[u8], format: ImageFormat) -> Result<DynamicImage, ImageError> {
    let (width, height) = header_size(bytes, format)?;
    let mut limits = image::Limits::no_limits();
    limits.max_alloc = Some(u64::from(width) * u64::from(height) * 8 + DECODER_SLACK_BYTES);
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    reader.limits(limits);
    let decoder = reader.into_decoder()?;
    // Room for all pixels is made before the first is read.
    if decoder.total_bytes() > EXPANSION_FREE_BYTES + EXPANSION_MAX * bytes.len() as u64 {
        let problem =
            format!("{} bytes cannot hold the {width} × {height} pixels of its header", bytes.len());
        return Err(ImageError::Decoding(DecodingError::new(format.into(), problem)));
    }
    DynamicImage::from_decoder(decoder)
}
