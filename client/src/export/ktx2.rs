//! KTX 2.0 files of one uncompressed picture, volume or array: half floats in linear light, packed by zstd.
//!
//! ```text
//! header 80 │ level index 24 │ data format descriptor 92 │ keys and values │ zstd frame
//! ```

use glam::Vec3;
use half::f16;

use crate::error::{ClientError, Result};

/// First bytes of a file.
const IDENTIFIER: [u8; 12] = *b"\xABKTX 20\xBB\r\n\x1A\n";
/// `VK_FORMAT_R16G16B16A16_SFLOAT`.
const RGBA16F: u32 = 97;
/// Bytes of a texel.
pub const TEXEL_BYTES: u64 = 8;
/// Supercompression by zstd.
const ZSTD: u32 = 2;
/// Higher → smaller files, more time.
const ZSTD_LEVEL: i32 = 9;
const HEADER_BYTES: u32 = 80;
const LEVEL_INDEX_BYTES: u32 = 24;
/// Words of the basic descriptor without samples, and of a sample.
const DESCRIPTOR_WORDS: u32 = 6;
const SAMPLE_WORDS: u32 = 4;
/// Channels as descriptors number them: red, green, blue, alpha.
const CHANNELS: [u32; 4] = [0, 1, 2, 15];

/// Extent of a picture, a volume or an array, in texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Width and height.
    size: [u32; 2],
    /// Slices of a volume; 0 for what is none.
    depth: u32,
    /// Layers of an array; 0 for what is none.
    layers: u32,
}

impl Shape {
    /// A picture.
    pub fn picture(size: [u32; 2]) -> Self {
        Self { size, depth: 0, layers: 0 }
    }

    /// A volume of so many texels along x, y and z.
    pub fn volume([width, height, depth]: [u32; 3]) -> Self {
        Self { size: [width, height], depth, layers: 0 }
    }

    /// An array of pictures.
    pub fn array(size: [u32; 2], layers: u32) -> Self {
        Self { size, depth: 0, layers }
    }

    fn texels(&self) -> u64 {
        let Self { size: [width, height], depth, layers } = *self;
        [width, height, depth.max(1), layers.max(1)].into_iter().map(u64::from).fold(1, u64::saturating_mul)
    }
}

/// A texel of these numbers and alpha 1.
pub fn opaque(numbers: Vec3) -> [f16; 4] {
    let [r, g, b] = numbers.to_array().map(f16::from_f32);
    [r, g, b, f16::ONE]
}

/// The file of so many texels: row after row from the top, slices or layers behind each other. Errs where they are not as many as the
/// shape says.
pub fn rgba16f(shape: Shape, texels: &[[f16; 4]]) -> Result<Vec<u8>> {
    let wanted = shape.texels();
    if wanted == 0 || texels.len() as u64 != wanted {
        let problem = format!("{shape:?} has {} texels", texels.len());
        return Err(ClientError::inconsistent("a page", problem));
    }
    let Shape { size, depth, layers } = shape;
    let texels: Vec<u8> = texels.iter().flatten().flat_map(|channel| channel.to_le_bytes()).collect();
    let packed = zstd::bulk::compress(&texels, ZSTD_LEVEL).map_err(|source| ClientError::File {
        action: "pack a page of",
        path: "the export".into(),
        source,
    })?;
    let (descriptor, pairs) = (descriptor(), pairs(shape));
    let descriptor_at = HEADER_BYTES + LEVEL_INDEX_BYTES;
    let pairs_at = descriptor_at + descriptor.len() as u32;
    let level_at = u64::from(pairs_at) + pairs.len() as u64;
    let mut file = IDENTIFIER.to_vec();
    // Format, bytes of a number, width, height, depth, layers, faces, levels, supercompression.
    push(&mut file, &[RGBA16F, 2, size[0], size[1], depth, layers, 1, 1, ZSTD]);
    push(&mut file, &[descriptor_at, descriptor.len() as u32, pairs_at, pairs.len() as u32]);
    // No global data, then the one level.
    for place in [0, 0, level_at, packed.len() as u64, texels.len() as u64] {
        file.extend(place.to_le_bytes());
    }
    file.extend(descriptor);
    file.extend(pairs);
    file.extend(packed);
    Ok(file)
}

/// The data format descriptor: linear Rec. 709, four signed half floats.
fn descriptor() -> Vec<u8> {
    let bytes = 4 * (DESCRIPTOR_WORDS + SAMPLE_WORDS * CHANNELS.len() as u32);
    let mut words = Vec::new();
    push(&mut words, &[4 + bytes, 0, 2 | bytes << 16]);
    // Model RGBSDA, primaries of Rec. 709, linear transfer, straight alpha; blocks of 1 texel, of 8 bytes.
    words.extend([1, 1, 1, 0, 0, 0, 0, 0, TEXEL_BYTES as u8, 0, 0, 0, 0, 0, 0, 0]);
    for (index, channel) in (0..).zip(CHANNELS) {
        // Bit offset, bits − 1, float and signed; ends of the range.
        let sample = (16 * index) | 15 << 16 | (0xC0 | channel) << 24;
        push(&mut words, &[sample, 0, (-1.0_f32).to_bits(), 1.0_f32.to_bits()]);
    }
    words
}

/// Keys and values: rows run to the right and down, slices away.
fn pairs(shape: Shape) -> Vec<u8> {
    let mut pairs = Vec::new();
    let orientation = if shape.depth == 0 { &b"KTXorientation\0rd\0"[..] } else { b"KTXorientation\0rdi\0" };
    for pair in [orientation, b"KTXwriter\0Lightkiln\0"] {
        push(&mut pairs, &[pair.len() as u32]);
        pairs.extend(pair);
        pairs.resize(pairs.len().next_multiple_of(4), 0);
    }
    pairs
}

fn push(bytes: &mut Vec<u8>, words: &[u32]) {
    bytes.extend(words.iter().flat_map(|word| word.to_le_bytes()));
}

#[cfg(test)]
mod tests {
    use ktx2::{Format, Reader, SupercompressionScheme};

    use super::*;

    #[test]
    fn reader_of_others_gives_the_texels_back() {
        let texels: Vec<[f16; 4]> = (0..15)
            .map(|index| [0.25, 1e-3, 6e4, 1.0].map(|value: f32| f16::from_f32(value * index as f32 / 15.0)))
            .collect();
        let file = rgba16f(Shape::picture([5, 3]), &texels).unwrap();
        let reader = Reader::new(&file).unwrap();
        let header = reader.header();
        assert_eq!(header.format, Some(Format::R16G16B16A16_SFLOAT));
        assert_eq!((header.pixel_width, header.pixel_height, header.pixel_depth), (5, 3, 0));
        assert_eq!((header.layer_count, header.face_count, header.level_count), (0, 1, 1));
        assert_eq!(header.supercompression_scheme, Some(SupercompressionScheme::Zstandard));
        let levels: Vec<_> = reader.levels().collect();
        assert_eq!(levels.len(), 1);
        assert_eq!(levels[0].uncompressed_byte_length, 15 * TEXEL_BYTES);
        let bytes = zstd::bulk::decompress(levels[0].data, 15 * TEXEL_BYTES as usize).unwrap();
        let wanted: Vec<u8> = texels.iter().flatten().flat_map(|channel| channel.to_le_bytes()).collect();
        assert_eq!(bytes, wanted);
        let pairs: Vec<_> = reader.key_value_data().collect();
        assert_eq!(pairs, [("KTXorientation", &b"rd\0"[..]), ("KTXwriter", &b"Lightkiln\0"[..])]);
    }

    #[test]
    fn volumes_and_arrays_say_how_deep_they_are() {
        let texels = vec![[f16::ONE; 4]; 24];
        for (shape, wanted) in [(Shape::volume([2, 3, 4]), (4, 0)), (Shape::array([2, 3], 4), (0, 4))] {
            let file = rgba16f(shape, &texels).unwrap();
            let reader = Reader::new(&file).unwrap();
            let header = reader.header();
            assert_eq!((header.pixel_width, header.pixel_height), (2, 3));
            assert_eq!((header.pixel_depth, header.layer_count), wanted);
            assert_eq!(reader.levels().next().unwrap().uncompressed_byte_length, 24 * TEXEL_BYTES);
        }
        assert!(rgba16f(Shape::volume([2, 3, 4]), &texels[1..]).is_err());
    }

    #[test]
    fn descriptor_is_that_of_half_floats() {
        let file = rgba16f(Shape::picture([1, 1]), &[[f16::ONE; 4]]).unwrap();
        let words: Vec<u32> =
            file[104..196].as_chunks::<4>().0.iter().map(|word| u32::from_le_bytes(*word)).collect();
        // Khronos Data Format: length; vendor and type, version and length; model, primaries, transfer and flags; sides of a texel's
        // block; bytes of its planes. Then offset, bits − 1 and kind, position, and ends of the range of each channel.
        #[rustfmt::skip]
        let wanted: [u32; 23] = [
            0x5C, 0, 0x0058_0002, 0x0001_0101, 0, 8, 0,
            0xC00F_0000, 0, 0xBF80_0000, 0x3F80_0000,
            0xC10F_0010, 0, 0xBF80_0000, 0x3F80_0000,
            0xC20F_0020, 0, 0xBF80_0000, 0x3F80_0000,
            0xCF0F_0030, 0, 0xBF80_0000, 0x3F80_0000,
        ];
        assert_eq!(words, wanted);
        // Where the header says that it is, and as a reader of others understands it.
        let reader = Reader::new(&file).unwrap();
        let block = reader.dfd_blocks().next().unwrap();
        let basic = ktx2::DfdBlockBasic::parse(block.data).unwrap();
        assert_eq!(basic.header.color_model, Some(ktx2::ColorModel::RGBSDA));
        assert_eq!(basic.header.transfer_function, Some(ktx2::TransferFunction::Linear));
        assert_eq!(basic.sample_information().count(), 4);
    }

    #[test]
    fn texels_that_are_not_as_many_as_the_size_says_are_refused() {
        for (size, count) in [([2, 2], 3), ([0, 4], 0), ([1, 1], 2)] {
            assert!(rgba16f(Shape::picture(size), &vec![[f16::ONE; 4]; count]).is_err(), "{size:?} {count}");
        }
    }
}
